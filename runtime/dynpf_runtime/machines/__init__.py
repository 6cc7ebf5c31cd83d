"""The protocol of a run as pure state machines: joining, ticks, journal, recording, ending.

A machine is given events and the time, and gives effects; it knows no bus, clock, signal or file. Who connects one to
these is ``dynpf_runtime.bus``; who connects those of a whole run to each other is ``dynpf_runtime.simulation``.
"""
