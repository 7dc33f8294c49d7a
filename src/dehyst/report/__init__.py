"""Reports: HTML pages, and plots of objects; the only room that uses matplotlib."""

from dehyst.report import plots
from dehyst.report.html import MINUS, Row, document, table
from dehyst.report.pages import write_report
from dehyst.report.plots import COLUMN, INK, PAGE, Drawing

__all__ = ["write_report"]
