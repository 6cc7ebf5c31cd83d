"""Pages of runs: one HTML file that needs nothing else, made of a recording."""

from dynpf_lab.page.making import Unmade, make_page, page_of

__all__ = ["Unmade", "make_page", "page_of"]
