"""The protocol of a run as pure state machines: joining, ticks, journal, recording, ending.

A machine takes events and the time, and returns effects; it knows no bus, clock, signal or file.
``dynpf_runtime.bus`` connects one machine to these; ``dynpf_runtime.simulation`` connects the machines of a whole run.
"""
