"""Self-contained HTML reports: one file, no network, light and dark, readable on a phone."""

from orbisim.report.page import render_page

__all__ = ["render_page"]
