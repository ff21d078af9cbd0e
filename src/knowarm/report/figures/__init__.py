"""Values go in; drawings in SVG, coloured by the page's style sheet, come out."""

from knowarm.report.figures.bars import stacked_bars
from knowarm.report.figures.density import Density, densities, density_chart
from knowarm.report.figures.dots import Dot, dot_chart
from knowarm.report.figures.frame import Box
from knowarm.report.figures.graph import graph_drawing
from knowarm.report.figures.heat import heat_strip
from knowarm.report.figures.lines import Series, line_chart

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
