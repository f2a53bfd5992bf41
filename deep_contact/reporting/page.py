"""All results of a folder as one page, `index.html`, that needs nothing but itself: no network, no file, no script.

Pictures and animations are embedded. The page forbids itself, by its content security policy, to load anything else.
"""

from __future__ import annotations

import base64
import html
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from deep_contact.io.files import replacing
from deep_contact.reporting import results
from deep_contact.reporting.errata import ERRATA, HEAD
from deep_contact.reporting.figures import cell

MEDIA = {".png": "image/png", ".gif": "image/gif", ".mp4": "video/mp4"}

POLICY = "default-src 'none'; img-src data:; media-src data:; style-src 'unsafe-inline'"

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto; padding: 1rem;
  max-width: 70rem; overflow-wrap: anywhere; }
h1, h2, h3 { line-height: 1.2; }
section { border-top: 1px solid #ddd; margin-top: 2rem; }
img, video { max-width: 100%; height: auto; display: block; margin: 1rem auto; }
a { color: #0072b2; }
nav ul { list-style: none; padding: 0; columns: 20rem; column-gap: 2rem; }
nav li { break-inside: avoid; padding: 0.3rem 0; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; }
th, td { border-bottom: 1px solid #ddd; padding: 0.4rem 0.5rem; text-align: left; vertical-align: top; }
ul.claims { list-style: none; padding: 0; }
ul.claims li { border-left: 0.35rem solid #009e73; padding: 0.2rem 0.8rem; margin: 0.8rem 0; background: #f6f6f6; }
ul.claims li.not { border-color: #d55e00; }
.measured { font-size: 0.9rem; color: #444; }
details { margin: 0.6rem 0; }
summary { cursor: pointer; padding: 0.3rem 0; }
.missing { color: #a33c00; }
@media (max-width: 45rem) {
  table.errata thead { display: none; }
  table.errata tr, table.errata td { display: block; border: 0; padding: 0.15rem 0; }
  table.errata tr { border-bottom: 1px solid #ddd; padding: 0.6rem 0; }
  table.errata td::before { content: attr(data-name) ": "; font-weight: bold; }
}
"""


def write_report(folder: str | os.PathLike, *, expected: Iterable[str] = ()) -> Path:
    """Write `index.html` into a folder of results files, in one move; its path.

    expected: ids ("3.7", "T 5.1") that should be there; those without results are named as missing. A results file
    that cannot be read is named with its fault, and does not stop the others. Raises FileNotFoundError where the
    folder is not there.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"folder of results: {folder} does not exist")
    found, faults = _collect(folder)
    known = {entry["id"] for entry in found}
    missing = [_name(id) for id in sorted(set(expected) - known, key=_order)]
    if missing:
        faults.append(f"No results of {', '.join(missing)}.")
    page = _page(found, faults, folder)
    path = folder / "index.html"
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _collect(folder: Path) -> tuple[list[dict], list[str]]:
    """The results in the order of their ids, and a line for each file that cannot be read."""
    found, faults = [], []
    for path in folder.glob("*.json"):
        if re.fullmatch(r"(figure|table)_[0-9A-Z]+_[0-9]+\.json", path.name):
            try:
                found.append({**results.read_results(path), "path": path})
            except results.ResultsError as error:
                faults.append(str(error))
    return sorted(found, key=lambda entry: _order(entry["id"])), sorted(faults)


def _order(id: str) -> tuple:
    chapter, number = id.removeprefix("T ").split(".")
    return chapter.zfill(4), int(number), id.startswith("T ")


def _name(id: str) -> str:
    return f"Table {id[2:]}" if id.startswith("T ") else f"Figure {id}"


def _anchor(id: str) -> str:
    return _name(id).lower().replace(" ", "-").replace(".", "-")


def _page(found: Sequence[dict], faults: Sequence[str], folder: Path) -> str:
    claims = [claim for entry in found for claim in entry["claims"]]
    thesis = [claim for claim in claims if claim["thesis"]]
    held = sum(claim["holds"] for claim in thesis)
    links = "".join(_link(entry) for entry in found)
    parts = [
        "<h1>Deep Contact: figures and tables</h1>",
        "<p>Rigid contact of circles on the plane, made faster by learning where the Projected Gauss-Seidel solver "
        "should start. Every picture below was computed by this package; every claim was tested on its numbers. "
        "“L669” is line 669 of the thesis's text.</p>",
        f"<p>{len(found)} figures and tables; of {len(thesis)} claims of the thesis, {held} hold and "
        f"{len(thesis) - held} do not.</p>",
        *(f'<p class="missing">{html.escape(fault)}</p>' for fault in faults),
        f'<nav aria-label="Contents"><ul>{links}<li><a href="#failing">Claims that do not hold</a></li>'
        '<li><a href="#errata">Errata of the thesis</a></li></ul></nav>',
        *_animations(folder),
        *(_section(entry) for entry in found),
        _failing(found),
        _errata(),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Deep Contact: figures and tables</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _link(entry: dict) -> str:
    claims = entry["claims"]
    count = f" <small>({sum(c['holds'] for c in claims)} of {len(claims)} hold)</small>" if claims else ""
    title = html.escape(f"{_name(entry['id'])}: {entry['title']}")
    return f'<li><a href="#{_anchor(entry["id"])}">{title}</a>{count}</li>'


def _section(entry: dict) -> str:
    name = _name(entry["id"])
    title = html.escape(f"{name}: {entry['title']}")
    picture = entry["path"].with_suffix(".png")
    image = f'<img alt="{title}" src="{_data(picture)}">' if picture.exists() else '<p class="missing">no picture</p>'
    claims = "".join(_claim(claim) for claim in entry["claims"])
    settings = {**entry["options"], "seed": entry["provenance"]["seed"]}
    made = {key: value for key, value in entry["provenance"].items() if key not in ("packages", "seed")}
    made |= {package: version for package, version in entry["provenance"]["packages"].items()}
    return (
        f'<section id="{_anchor(entry["id"])}">\n<h2>{title}</h2>\n{image}\n'
        + (f'<ul class="claims">{claims}</ul>\n' if claims else "")
        + f"<details><summary>Settings</summary>{_table(settings)}</details>\n"
        + f"<details><summary>Provenance</summary>{_table(made)}</details>\n</section>"
    )


def _claim(claim: dict) -> str:
    source = f" <small>({html.escape(claim['thesis'])})</small>" if claim["thesis"] else ""
    measured = "; ".join(
        f"{html.escape(name)} = {html.escape(cell(value))}" for name, value in claim["measured"].items()
    )
    word, kind = ("holds", "") if claim["holds"] else ("does not hold", ' class="not"')
    text = html.escape(claim["text"])
    return f'<li{kind}><strong>{word}:</strong> {text}{source}<br><span class="measured">{measured}</span></li>'


def _table(values: dict) -> str:
    rows = "".join(
        f"<tr><th scope='row'>{html.escape(str(name))}</th><td>{html.escape(cell(value))}</td></tr>"
        for name, value in values.items()
    )
    return f"<table>{rows}</table>"


def _failing(found: Sequence[dict]) -> str:
    items = [
        f'<li class="not"><a href="#{_anchor(entry["id"])}">{_name(entry["id"])}</a>: {html.escape(claim["text"])} '
        f"<small>({html.escape(claim['thesis'])})</small></li>"
        for entry in found
        for claim in entry["claims"]
        if claim["thesis"] and not claim["holds"]
    ]
    listed = f'<ul class="claims">{"".join(items)}</ul>' if items else "<p>None.</p>"
    return f'<section id="failing">\n<h2>Claims of the thesis that do not hold</h2>\n{listed}\n</section>'


def _errata() -> str:
    head = "".join(f'<th scope="col">{name}</th>' for name in HEAD)
    rows = "".join(
        "<tr>" + "".join(f'<td data-name="{n}">{html.escape(text)}</td>' for n, text in zip(HEAD, erratum)) + "</tr>"
        for erratum in ERRATA
    )
    return (
        '<section id="errata">\n<h2>Errata of the thesis, and what is done here</h2>\n'
        f'<table class="errata"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>\n</section>'
    )


def _animations(folder: Path) -> list[str]:
    """Each animation of the folder once: as a film where there is one, which is smaller than its GIF."""
    shown = []
    for gif in sorted(folder.glob("animation*.gif")):
        film = gif.with_suffix(".mp4")
        text = html.escape(gif.stem.replace("_", " "))
        if film.exists():
            media = f'<video controls loop muted playsinline src="{_data(film)}"></video>'
        else:
            media = f'<img alt="{text}" src="{_data(gif)}">'
        shown.append(f'<section id="{gif.stem}">\n<h2>{text.capitalize()}</h2>\n{media}\n</section>')
    return shown


def _data(path: Path) -> str:
    return f"data:{MEDIA[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
