"""The proof that dynpf gives the same bytes on every machine: one list of jobs, run under many choices of kernels.

``python -m checks.machines`` runs the matrix on this processor, ``... arm64`` and ``... old-x86`` run the same jobs on
another processor in emulation. docs/machines.md tells what is promised and what each setting and control is.
"""
