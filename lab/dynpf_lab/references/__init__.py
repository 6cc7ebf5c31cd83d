"""Reference recordings: small recorded runs in ``recordings/`` of a checkout, and what each of them must reproduce.

``check`` replays and reruns them, ``update`` makes them anew and reports what changed. Bytes are compared, on whatever
machine.
"""
