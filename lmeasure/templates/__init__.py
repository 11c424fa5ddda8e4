"""Rigs to begin with: shapes of cells, what an error of each dimension costs, and files in which everything is explained."""

from lmeasure.templates.costs import Cost, costs
from lmeasure.templates.files import folder_files, rig_text
from lmeasure.templates.shapes import TEMPLATES, Answers, Template, rig_of

__all__ = ["TEMPLATES", "Answers", "Cost", "Template", "costs", "folder_files", "rig_of", "rig_text"]
