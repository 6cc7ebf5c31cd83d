"""Reference recordings: small recorded runs in ``recordings/`` of a checkout, and what each of them must reproduce.

``check`` replays and reruns them, ``update`` makes them anew and reports what changed. On the platform that recorded
them bytes are compared; elsewhere values, within tolerances.
"""
