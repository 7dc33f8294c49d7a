"""Reports: HTML pages, and plots of objects; the only room that uses matplotlib."""

from dehyst.report import plots
from dehyst.report.comparison_page import write_comparison
from dehyst.report.html import MINUS, Row, document, table
from dehyst.report.pages import write_record_page, write_stage_report
from dehyst.report.plots import COLUMN, INK, PAGE, Drawing
from dehyst.report.report import write_calibration, write_report
from dehyst.report.trust_section import write_insight

__all__ = [
    "write_calibration",
    "write_comparison",
    "write_insight",
    "write_record_page",
    "write_report",
    "write_stage_report",
]
