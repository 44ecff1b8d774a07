"""Jobs: many inputs, each done once, however often the command is killed and typed again.

A job has a manifest in its folder (``manifest``), which knows what is done and by which settings (``settings``). Its
inputs come one after the other (``inputs``), from folders, lists, archives and stores (``origins``), and its files go
to a folder (``destinations``) or a store (``store``). ``run`` does them in this process, ``ray_engine`` on a cluster,
and both map the same function, ``work.do_photo``. ``report`` adds up and merges the manifests of shards.
"""
