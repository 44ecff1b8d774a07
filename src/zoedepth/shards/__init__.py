"""Shards: samples in plain tar files, which we read in any order by their offsets, and the ``webdataset`` package reads
in sequence.

Each sample is a group of members with one key::

    00000000.depth.png      or .depth.npz; .disparity.… for disparity
    00000000.jpg            the photo, in the bytes of its own file
    00000000.json           {"depth_scale": 1000, "domain": "indoor", "kind": "depth", "name": "image/0001.jpg"}

A sample may also have ``.mask.png``, and fx, fy, cx, cy in its JSON.
"""
