"""Components of pages, shared by reports, workbench and site: charts, path editor, numbers, style."""

from dehyst.web import files
