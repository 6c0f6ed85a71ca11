"""Writes docs/tuning.md from `fieldkit.tuning`: python docs/tuning_page.py. A test holds the page against the code."""

from dataclasses import fields
from pathlib import Path

from fieldkit.tuning import Tuning

HEAD = """\
# Numbers that belief and planners are tuned by

All stand in `fieldkit.tuning`, and this page is made from there (`python docs/tuning_page.py`). A mission that says
nothing takes these. A table such as `[tuning.intensity]` in mission.toml sets one anew, and so does a what-if:

    fieldkit replay mission.mcap --set tuning.intensity.birth_odds=2

A recording's header keeps all of them, so it replays the same after a later version has chosen otherwise. What a
mission is asked for (probabilities, limits, ranges) stands in `fieldkit.settings` instead; tolerances of arithmetic
stand beside their loops.
"""


def page() -> str:
    """The whole page."""
    lines = [HEAD]
    for table in fields(Tuning):
        part = getattr(Tuning(), table.name)
        lines += [f"## {table.name}", "", (type(part).__doc__ or "").strip(), ""]
        lines += ["| key | value | unit | meaning | where it comes from |", "|---|---|---|---|---|"]
        for each in fields(part):
            default = each.default
            shown = ", ".join(f"{one:g}" for one in default) if isinstance(default, tuple) else f"{default:g}"
            quantity = each.metadata["quantity"]
            source = each.metadata["source"]
            lines.append(
                f"| `{table.name}.{each.name}` | {shown} | {quantity.unit} | {quantity.meaning} | {source} |"
            )
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    Path(__file__).with_name("tuning.md").write_text(page(), encoding="utf-8")
