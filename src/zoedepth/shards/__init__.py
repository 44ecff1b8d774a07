"""Shards: samples in plain tar files, read at random by their offsets, and by the ``webdataset`` package.

Each sample is a group of members with one key::

    00000000.depth.png      or .depth.npz; .disparity.… for disparity
    00000000.jpg            the photo, its file's own bytes
    00000000.json           {"depth_scale": 1000, "domain": "indoor", "kind": "depth", "name": "image/0001.jpg"}

Optional are ``.mask.png`` and fx, fy, cx, cy in the JSON.
"""
