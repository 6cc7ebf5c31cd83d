"""Edits of recordings that know their structure, with every checksum made right again.

``content`` takes a recording apart and writes it again, ``kinds`` has the edits, ``judge`` finds out what notices them;
``python -m checks.edits`` makes many and prints what was found by what.
"""
