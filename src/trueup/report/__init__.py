"""Self-contained HTML from saved results; needs neither MuJoCo nor torch."""

from trueup.report.builder import build_report as build_report
from trueup.report.builder import write_report as write_report

__all__ = ["build_report", "write_report"]
