"""Values go in; drawings in SVG, coloured by the page's style sheet, come out."""

from knowarm.experiment.report.figures.bars import stacked_bars
from knowarm.experiment.report.figures.density import Density, densities, density_chart
from knowarm.experiment.report.figures.dots import Dot, dot_chart
from knowarm.experiment.report.figures.frame import Box
from knowarm.experiment.report.figures.graph import graph_drawing
from knowarm.experiment.report.figures.heat import heat_strip
from knowarm.experiment.report.figures.lines import Series, line_chart

__all__ = [
    "Box",
    "Density",
    "Dot",
    "Series",
    "densities",
    "density_chart",
    "dot_chart",
    "graph_drawing",
    "heat_strip",
    "line_chart",
    "stacked_bars",
]
