"""The skeleton of the page: one file, no external resource, and no user text as markup."""

import json
import re

import pytest
from message_helpers import naming
from report_helpers import UNFRIENDLY, Elements, html_of, write_recall, write_sweep

from tactile_loc.core.runtime.errors import OutputError
from tactile_loc.reports import write_report
from tactile_loc.reports.page import Page, Section, render


@pytest.fixture(params=["run_folder", "recall_folder", "sweep_folder"])
def html(request) -> str:
    return html_of(request.getfixturevalue(request.param))


def test_a_page_loads_nothing_from_elsewhere_has_a_moderate_size_and_links_with_targets(html):
    found = Elements(html)
    for _, attributes in found.elements:
        for name in ("src", "href", "data", "action", "srcset", "poster"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:", "#")), value
    assert not re.search(r"@import|url\(", "".join(re.findall(r"<style>(.*?)</style>", html, re.DOTALL)))
    (policy,) = [a["content"] for a in found.named("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert str(policy).startswith("default-src 'none'")
    assert "http" not in str(policy)
    assert len(re.findall(r"plotly\.js v\d", html)) == 1
    assert 1.5e6 < len(html) < 5e6
    names = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(names) == len(set(names))
    assert {a["href"] for a in found.named("a")} <= {f"#{name}" for name in names}


def test_bytes_in_names_become_escapes():
    assert rb"folder Geh\xe4use" in render(Page("live", "title", "folder Geh\udce4use", [], {}, [])).encode()


def test_user_names_are_shown_as_text(unfriendly_run, tmp_path):
    evaluation, sweep = tmp_path / "evaluation", tmp_path / "sweep"
    evaluation.mkdir()
    sweep.mkdir()
    write_recall(evaluation, names=(UNFRIENDLY, "pin"))
    write_sweep(sweep, lambda rows: (rows[0].update(object=UNFRIENDLY), rows[1].update(error=UNFRIENDLY)))
    for folder in (unfriendly_run, evaluation, sweep):
        html = html_of(folder)
        assert html.count("<script") - html.count("'<script") >= 3
        assert "<script>alert" not in html
        scripts = [a for a in Elements(html).named("script") if a.get("type") is None]
        assert len(scripts) <= 4  # plotly and the scripts of the page
        assert UNFRIENDLY in Elements(html).text


def test_data_cannot_close_its_script_element():
    html = render(Page("run", "t", "a", [], {"a": "</script><!--"}, []))
    (data,) = re.findall(r'id="data">(.*)</script>', html)
    assert "</script" not in data
    assert json.loads(data) == {"a": "</script><!--"}
    with pytest.raises(ValueError, match="JSON"):
        render(Page("run", "t", "a", [], [float("nan")], []))


def test_the_page_permits_only_its_own_scripts():
    html = render(Page("run", "t", "a", [Section("times", "S", {"built": ""})], {}, ["solids.js"]))
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]*)"', html)
    assert policy.count("'sha256-") == 3
    assert "unsafe-inline" not in policy.split("script-src")[1]


def test_a_report_is_written_completely_or_not_at_all(recall_folder, tmp_path):
    written = write_report(recall_folder, tmp_path / "new" / "page.html")
    assert written.read_text(encoding="utf-8").endswith("</html>\n")
    assert [path.name for path in written.parent.iterdir()] == ["page.html"]
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=naming("page.html", "`out`")):
        write_report(recall_folder, tmp_path / "file" / "page.html")
