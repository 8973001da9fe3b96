"""Names and messages are shown literally: no HTML, link or picture, and no other way to write Markdown on the page."""

import ast
import html
import re
from pathlib import Path

import pytest

from tactile_loc_app.export import _TEMPLATE
from tactile_loc_app.page import markdown
from tactile_loc_app.page.markdown import Paragraph, escape

APP = Path(markdown.__file__).parent
DRAWS_MARKUP = {"add_markdown", "add_html", "add_plotly", "add_uplot", "add_modal"}
HOSTILE = (
    "<iframe srcdoc='<script>parent.hacked=1</script>'>",
    "<img src=x onerror=hacked=1>",
    "[x](javascript:hacked=1)",
    "![](http://evil.example/a.png)",
    "# big",
    "- a",
    "1. a",
    "a | b",
    "`a`",
    "**a**",
    "http://evil.example",
    "a\\b",
    "www.evil.example",
    "me@evil.example",
    "&lt;b&gt;",
    "    indented",
    "a\n\n<b>b</b>",
    "~~a~~",
    "---",
    "{} {0}",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_markdown_has_no_sign_of_a_text(text):
    written = escape(text).replace("<!-- -->", "")
    assert html.unescape(written) == " ".join(text.split())
    assert not re.search(r"[^\w ]|_", re.sub(r"&#\d+;", "", written))
    assert not re.search(r"[^\s>]&#(46|58|64);", escape(text))  # no address is in one piece, so none becomes a link


def test_control_characters_and_turned_writing_are_escaped():
    assert html.unescape(escape("a\x00b\u202ec\n d")) == r"a\x00b\u202ec d"


def test_only_the_values_of_a_paragraph_are_escaped():
    class Gui:
        content, visible = "", True

        def add_markdown(self, content, visible):
            return self

    client = type("Client", (), {"gui": Gui()})()
    paragraph = Paragraph(client)
    paragraph.fill("**{}**\n", "<b>", row="| {} |\n", rows=[("|",), (2,)])
    assert client.gui.content == "**&#60;b&#62;**\n| &#124; |\n| 2 |\n"


def calls(tree: ast.AST, *names: str) -> list[ast.Call]:
    found = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return [call for call in found if getattr(call.func, "attr", getattr(call.func, "id", "")) in names]


def is_constant(text: ast.expr) -> bool:
    """Whether a text is written in the program: a constant, a choice of two, or with the value of a constant."""
    match text:
        case ast.IfExp():
            return is_constant(text.body) and is_constant(text.orelse)
        case ast.JoinedStr():
            return all(is_constant(part) for part in text.values)
        case ast.FormattedValue():
            return is_constant(text.value)
        case ast.Name():
            return text.id.isupper()
    return isinstance(text, ast.Constant)


def test_few_modules_write_markup_and_all_templates_are_constant():
    writers = set()
    for path in APP.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        targets = [target for node in ast.walk(tree) if isinstance(node, ast.Assign) for target in node.targets]
        if calls(tree, *DRAWS_MARKUP) or any(getattr(target, "attr", "") == "content" for target in targets):
            writers.add(path.name)
        templates = [call.args[0] for call in calls(tree, "fill")]
        templates += [call.args[1] for call in calls(tree, "Paragraph") if len(call.args) > 1]
        templates += [k.value for call in calls(tree, "fill") for k in call.keywords if k.arg == "row"]
        assert [ast.unparse(text) for text in templates if not is_constant(text)] == [], path
    assert writers == {"markdown.py", "overlay.py", "sensor_cover.py"}  # the last one shows no text of a visitor


def test_notifications_and_lists_show_one_line():
    for path in APP.glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for call in calls(tree, "add_notification"):
            assert [ast.unparse(text.func) for text in call.args] == ["fold_line", "fold_line"]
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "attr", "") == "options":
                assert "list_numbered" in ast.unparse(node.value), path


def test_a_name_stays_in_the_comment_of_the_exported_script():
    values = dict.fromkeys(("count", "script", "units", "symmetry", "prior"), "x")
    text = _TEMPLATE.format(name='"""\nhacked = 1\n"""', touches="[]", object="0", sensor="0", **values)
    assert "hacked" not in {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}
