"""`knowarm knowledge probe`: test which facts can be recovered from the vectors."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from knowarm.cli.knowledge.options import SceneOptions, write_text
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.knowledge.draw import heatmap_svg
from knowarm.knowledge.probe import NEARLY_SAME, probe


@dataclass(frozen=True, kw_only=True)
class ProbeCommand(SceneOptions):
    """Test whether facets can be told apart and their facts recovered from the vectors."""

    svg: Path | None = None
    """Draw the cosines to this SVG file."""
    json: Path | None = None
    """Write the same as JSON to this file."""

    def run(self) -> None:
        """Print cosines, the accuracy of linear probes, and a warning where facets are alike."""
        check_json_path(self.json)
        config = self.config()
        found = probe(config, self.facets())
        what = self.agent or config.source.short_name
        numbers = [str(i) for i in range(1, len(found.slots) + 1)]
        print_table(
            f"Cosine of facets: {what}",
            ["", "facet", *numbers],
            [
                [numbers[i], name, *(None if np.isnan(x) else float(x) for x in found.cosine[i])]
                for i, name in enumerate(found.slots)
            ],
        )
        if found.recovered:
            print_table(
                "Share recovered by a linear probe",
                ["target", "the task's", "all objects'", "by guessing"],
                [[what, s["task"], s["all"], s["guess"]] for what, s in found.recovered.items()],
            )
        else:
            print("Nothing to recover: these numbers do not come from the facts about the objects.")
        for first, second, cosine in found.nearly_same:
            print(f"Warning: {first} and {second} are nearly the same (cosine {cosine:.3f}).")
        if found.nearly_same:
            print(
                "A policy can hardly tell these apart. Slots are farther apart with "
                "--no-relation-words --pooling sif --centring --colour-share 0.6 --slot-norm 1."
            )
        elif found.recovered:
            print(f"Every pair of facets can be told apart: all cosines below {NEARLY_SAME}.")
        if self.svg is not None:
            note = f"the largest of two different facets: {found.largest:.3f}"
            image = heatmap_svg(found.cosine, found.slots, f"Cosine of facets: {what}", note)
            write_text(self.svg, image)
        write_json_table(self.json, found.describe())
