"""Claims of one task go in; their table and the drawing of their intervals come out."""

from collections.abc import Sequence

from knowarm.report import format
from knowarm.report.blocks import Block, Column, Figure, Panel, Row, Table
from knowarm.report.claims import OUTCOMES, Claim
from knowarm.report.figures import Dot, dot_chart
from knowarm.report.palette import colours
from knowarm.report.study import Task

COLUMNS = (
    Column(key="outcome", label="outcome"),
    Column(key="first", label="agent"),
    Column(key="second", label="against"),
    Column(key="difference", label="difference [points]", format="points", interval=True),
    Column(key="seeds", label="seeds"),
    Column(key="effect_size", label="in std", format="signed", hint="Cohen's d"),
    Column(key="p", label="p", format="p", hint="Welch's t, two-sided"),
    Column(
        key="adjusted_p",
        label="adjusted p",
        format="p",
        hint="Holm over the gates of the report; controls by the number of gates",
    ),
    Column(key="verdict", label="verdict"),
    Column(
        key="needed",
        label="seeds needed",
        format="integer",
        hint="of each agent, to show a difference as large as the one seen in 80 % of studies",
    ),
)

NOTE = (
    "Interval: Welch's t, 95 %, not corrected. Seeds needed: for a difference as large as the one "
    "seen, 80 % power, two-sided 5 %, one comparison; differences that were picked because they "
    "are large make it too small. Verdicts other than better and worse are no evidence of "
    "equality: the interval says which differences remain possible. Described: no claim is made."
)


def comparisons(task: Task, claims: Sequence[Claim]) -> list[Block]:
    """Every difference the report decides on."""
    if not claims:
        return []
    panels = []
    for outcome, words in OUTCOMES.items():
        mine = [c for c in claims if c.outcome == outcome and c.comparison]
        if mine:
            panels.append(Panel(svg=forest(mine, f"{words}, {task.title}"), title=words))
    table = Table(
        name=f"comparisons-{task.name}",
        title=f"Differences between agents: {task.title}",
        columns=COLUMNS,
        rows=[_row(claim) for claim in claims],
        sources=[run.path for run in task.runs],
        note=NOTE,
    )
    if not panels:
        return [table]
    return [
        Figure(
            title=f"Differences between agents: {task.title}",
            caption="Difference of means in percentage points with its 95 % interval. What touches "
            "the upright line is not told apart from chance.",
            panels=panels,
            table=table,
            open_table=True,
        )
    ]


def forest(claims: Sequence[Claim], name: str) -> str:
    """Draw the intervals of differences around the line of no difference."""
    chosen = colours(group.name for group in claims[0].task.groups)
    dots = []
    for claim in claims:
        assert claim.comparison is not None
        interval = claim.comparison.difference
        dots.append(
            Dot(
                name=f"{claim.first.name} \u2212 {claim.second.name}",
                colour=chosen[claim.second.name],
                value=interval.estimate,
                low=interval.low,
                high=interval.high,
            )
        )
    return dot_chart(
        dots,
        f"Differences in {name}",
        x_title="difference [points]",
        x_format=lambda value: format.points(value, 0),
        zero=True,
        width=390,
        left=132,
    )


def _row(claim: Claim) -> Row:
    row: Row = {
        "outcome": OUTCOMES[claim.outcome],
        "first": claim.first.name,
        "second": claim.second.name,
        "verdict": claim.verdict,
        "needed": claim.needed if claim.verdict not in ("better", "worse") else None,
        "adjusted_p": claim.adjusted_p,
    }
    compared = claim.comparison
    if compared is None:
        return row | {"seeds": str(claim.seeds)}
    return row | {
        "difference": compared.difference.estimate,
        "difference_low": compared.difference.low,
        "difference_high": compared.difference.high,
        "seeds": f"{compared.first_count} / {compared.second_count}",
        "effect_size": compared.effect_size,
        "p": compared.p_value,
    }
