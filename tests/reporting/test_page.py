"""The page of all results: complete, alone in the world, and readable on a phone."""

import json
import re
from html.parser import HTMLParser

import pytest

from deep_contact.reporting import page as report_page
from deep_contact.reporting import plotting, results


def entry(id, **changes):
    """Results with a claim that holds and one that does not."""
    claims = [
        {"text": "θ < 1 & so on", "thesis": "section 3.4.1", "holds": True, "measured": {"θ": 0.125}},
        {"text": "the <other>", "thesis": "section 1.2", "holds": False, "measured": {"n": 3}},
    ]
    made = results.provenance(seed=7, wall_s=1.0)
    found = {"id": id, "title": f"Title {id}", "options": {"d": [0.25, 0.5]}, "provenance": made, "claims": claims}
    return {**found, "data": {}, **changes}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two figures, a table; and files that do not belong to it. There are no reference runs."""
    monkeypatch.setattr(results, "REFERENCE", tmp_path / "reference")
    for id, stem in (("3.10", "figure_3_10"), ("3.9", "figure_3_9"), ("T 5.1", "table_5_1")):
        results.write_results(tmp_path / f"{stem}.json", entry(id))
        plotting.save(plotting.subplots()[0], tmp_path / f"{stem}.png")
    (tmp_path / "other.json").write_text("{")
    return tmp_path


class Page(HTMLParser):
    """Tags that are open, all attributes, and the headings."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.headings = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.attributes.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def test_the_page_has_every_result_in_order_and_is_well_formed(folder):
    page = Page(report_page.write_report(folder).read_text())
    assert page.open == []
    assert page.headings[:3] == ["Figure 3.9: Title 3.9", "Figure 3.10: Title 3.10", "Table 5.1: Title T 5.1"]
    assert sum(a.get("data-name") == "Where" for _, a in page.attributes) == sum(map(len, report_page.ERRATA.values()))
    anchors = {attributes["id"] for _, attributes in page.attributes if "id" in attributes}
    links = {attributes["href"] for tag, attributes in page.attributes if tag == "a"}
    assert links == {f"#{anchor}" for anchor in anchors}


def test_the_page_asks_for_nothing_beyond_itself(folder):
    page = Page(report_page.write_report(folder).read_text())
    sources = [attributes["src"] for _, attributes in page.attributes if "src" in attributes]
    assert [source[:11] for source in sources] == ["data:image/"] * 3
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.attributes}
    policies = [attributes["content"] for tag, attributes in page.attributes if "http-equiv" in attributes]
    assert policies == [report_page.POLICY]


def test_a_claim_that_holds_in_part_is_no_yes_and_no_no(folder):
    found = entry("3.9")
    found["claims"][0] |= {"holds": None, "verdict": "holds, sweeps 1 to 180; does not hold, sweeps 250 to 3000"}
    found["claims"][1] |= {"holds": None, "verdict": "within the noise"}
    results.write_results(folder / "figure_3_9.json", found)
    text = report_page.write_report(folder).read_text()
    assert "2 hold, 1 hold in part, 2 do not, and 1 are left open" in text
    assert '<li class="part"><strong>holds, sweeps 1 to 180; does not hold, sweeps 250 to 3000:</strong>' in text
    assert '<li class="open"><strong>within the noise:</strong>' in text


def test_what_is_missing_or_damaged_is_said(folder):
    (folder / "figure_4_1.json").write_text(json.dumps(entry("4.1") | {"title": ""}))
    (folder / "figure_3_9.png").unlink()
    captions = {"3.10": "a < b.", "3.9": "", "5.7": ""}
    text = report_page.write_report(folder, expected=["3.9", "5.7", "T 5.2"], captions=captions).read_text()
    missing = re.findall(r'<p class="missing">(.*)</p>', text)
    assert "No results of Table 5.2, Figure 5.7." in missing
    assert "figure_4_1.json: title: expected text" in text
    assert text.count("no picture") == 1
    assert re.findall("<figcaption>.*</figcaption>", text) == ["<figcaption>a &lt; b.</figcaption>"]


def test_a_quick_run_is_called_so_and_contradicts_nothing(folder):
    full, other = entry("3.9"), entry("3.10", options={"d": [0.5]})
    other["claims"][1]["holds"] = True
    results.write_results(folder / "reference" / "figure_3_9.json", full)
    results.write_results(folder / "reference" / "figure_3_10.json", other)
    text = report_page.write_report(folder).read_text()
    assert text.count("Full run: the settings of the reference run.") == 1
    assert text.count("Quick run, or other settings than the reference run's.") == 1
    assert "<strong>as in the reference run, holds:</strong> θ" in text
    assert '<li class="open"><strong>too few states to tell (reference run: holds):</strong> the &lt;other&gt;' in text
    assert "of 6 claims of the thesis, 3 hold, 0 hold in part, 2 do not, and 1 are left open" in text
    assert "other settings than the reference runs: 1." in text
    assert text.count("the &lt;other&gt;") == 5  # not in the list of those that do not hold
