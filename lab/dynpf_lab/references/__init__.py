"""Reference recordings: small recorded runs in ``recordings/`` of a checkout, which every change must reproduce.

``check`` replays and reruns them, ``update`` records them again and reports the changes. Bytes are compared, on any
machine.
"""
