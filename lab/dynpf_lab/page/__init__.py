"""Pages of runs: one HTML file that needs nothing else, made of a recording."""

from dynpf_lab.page.making import make_page, page_of

__all__ = ["make_page", "page_of"]
