"""One page per experiment, from the results that are kept in baselines/results.

`python docs/experiments.py` writes them to docs/experiments; building the documentation does, too.
Their numbers and pictures are read from the records; the notes are those of the experiments.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from baselines import reproduction
from baselines.report import markdown_table
from baselines.reproduction_tables import cells, side_by_side

RESULTS = Path(reproduction.__file__).parent / "results"


def write_pages(folder: Path) -> None:
    """Write the pages, copy their pictures, and write the page that lists them."""
    folder.mkdir(exist_ok=True)
    names = reproduction.names()
    for name in names:
        kept = RESULTS / name
        (folder / f"{name}.md").write_text(page(name, kept), encoding="utf-8")
        if (kept / "figure.png").is_file():
            shutil.copyfile(kept / "figure.png", folder / f"{name}.png")
    (folder / "index.md").write_text(listing(list(names)), encoding="utf-8")


def page(name: str, kept: Path) -> str:
    """Return the page of an experiment as Markdown, with its results if there are any."""
    what = reproduction.find(name)
    text = [f"# {name}", "", what.title + ".", ""]
    notes = [line for note in what.notes for line in (note, "")]
    if not (kept / "summary.json").is_file():
        command = ["```sh", f"bnprl reproduce {name}", "```", ""]
        return "\n".join([*text, *notes, "No full run is kept yet.", "", *command])
    summary: dict[str, Any] = json.loads((kept / "summary.json").read_bytes())
    text += [f"![{what.title}]({name}.png)", "", *notes]
    if summary["shape"] == "table":
        text += [markdown_table(side_by_side(summary["panels"])), ""]
    for panel in summary["panels"]:
        text += [f"## {panel['title']}: {panel['measure']}", ""]
        text += [markdown_table(cells(panel["rows"], panel["x"])), ""]
    return "\n".join([*text, "```sh", summary["command"], "```", ""])


def listing(names: Sequence[str]) -> str:
    """Return the page that lists the experiments."""
    rows = [["experiment", "what it is"]]
    rows += [[f"[{name}]({name}.md)", reproduction.find(name).title] for name in names]
    toctree = "\n".join(["learners", *names])
    return f"""# Experiments

Tables and figures of the source, remade by `bnprl reproduce NAME`, all of them by
`bnprl reproduce --all`; `--quick` gives each of them two minutes. [What the strong learners
reach](learners.md) is on a page of its own.

{markdown_table(rows, numbers=False)}

```{{toctree}}
:hidden:

{toctree}
```
"""


if __name__ == "__main__":
    write_pages(Path(__file__).parent / "experiments")
