"""Simulation: the machines of a whole run in one process, on a network, a clock and a disk of its own.

``network`` connects the machines, ``faults`` says what may befall them, ``schedule`` draws faults from a seed,
``trial`` plays a schedule, ``invariants`` judges how the run ended, ``shrink`` finds the fewest faults, and
``timeline`` tells the story.
"""

from dynpf_runtime.simulation.network import Happened, Network, Simulation

__all__ = ["Happened", "Network", "Simulation"]
