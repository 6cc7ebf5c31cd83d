"""How figures look: colours that everybody tells apart, and line styles that tell them apart in print, too."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

__all__ = ["BODIES", "EDGES", "RC", "ROLES", "STATUS"]

RC: Mapping[str, Any] = MappingProxyType(
    {
        "font.size": 9.0,
        "axes.titlesize": 10.0,
        "font.family": "DejaVu Sans",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "svg.hashsalt": "dynpf",
        "svg.fonttype": "none",
        "pdf.fonttype": 42,
        "savefig.dpi": 150,
    }
)
"""Settings of matplotlib; text stays text in SVG and PDF, and the same run gives the same file."""

# Okabe and Ito's colours.
ROLES: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "truth": {"color": "#222222", "lw": 2.6, "alpha": 0.45, "label": "true path"},
        "estimate": {"color": "#d55e00", "lw": 1.1, "label": "estimate"},
        "odometry": {"color": "#0072b2", "lw": 1.2, "ls": "--", "label": "odometry alone"},
        "body": {"lw": 1.4},
    }
)
ESTIMATES = ("#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
BODIES = ("#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#0072b2", "#f0e442")
EDGES: Mapping[str, str] = MappingProxyType(
    {"wall": "#333333", "landmark": "#111111", "goal": "#009e73", "obstacle": "#999999", "drawn": "#777777"}
)
STATUS: Mapping[str, str] = MappingProxyType(
    {
        "tracking": "#009e73",
        "uncertain": "#e69f00",
        "lost": "#d55e00",
        "kidnapped": "#cc79a7",
        "map_does_not_fit": "#555555",
    }
)
