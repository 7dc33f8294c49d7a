"""What pages are made of: charts, the editor of a path, numbers, style. One folder for reports, workbench and site."""

from dehyst.web import files
