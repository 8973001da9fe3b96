"""Hook of mkdocs that shows the notebooks of docs/notebooks as pages, with their outputs.

The outputs are those of the executed copies, which `scripts/notebooks.py` writes. Without an up-to-date copy, the page
states that the outputs are missing. A notebook becomes Markdown, so that its links are checked, its words can be
found, and it looks like the other pages.
"""

import base64
import re
from pathlib import Path
from typing import Any

import nbformat
import notebooks
from mkdocs.structure.files import File, Files

ANSI = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")  # colours of a terminal
EXECUTED = """\
The build of this page ran the notebook, so its outputs are those of the present version. \
<a href="{download}" download>Download the notebook</a>."""
PLAIN = """\
!!! warning "Without outputs"
    This site was built without running its notebooks. <a href="{download}" download>Download the notebook</a> and run
    it, or build the site with `make docs`."""


class NotebookFile(File):
    """A notebook that is a page. Links to it name its .ipynb file."""

    def is_documentation_page(self) -> bool:
        """Return True, although the file is not Markdown."""
        return True


def on_files(files: Files, config: Any) -> Files:
    """Replace each notebook by its page, its pictures, and a copy to download."""
    for file in [file for file in files if file.src_uri.startswith("notebooks/") and file.src_uri.endswith(".ipynb")]:
        source = Path(file.abs_src_path or "")
        folder = f"notebooks/{file.name}"
        text, pictures = convert(source, f"{file.name}/")
        page = NotebookFile.generated(config, file.src_uri, content=text)
        files.remove(file)
        files.append(page)
        files.append(File.generated(config, f"{folder}/{source.name}", abs_src_path=str(source)))
        for name, content in pictures.items():
            files.append(File.generated(config, f"{folder}/{name}", content=content))
    return files


def convert(path: Path, folder: str) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown, and its pictures by name. Markdown names files of the notebook in `folder`."""
    executed = notebooks.read_executed(path)
    notebook = executed or nbformat.read(path, as_version=4)
    about = (EXECUTED if executed else PLAIN).format(download=f"{folder}{path.name}")
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        else:
            parts.append(_fence(cell.source, "python"))
            shown = [_convert_output(output, folder, pictures) for output in cell.outputs]
            if any(shown):
                parts.append("\n\n".join(['<div class="result" markdown>', *filter(None, shown), "</div>"]))
    parts.insert(1, about)
    return "\n\n".join(parts) + "\n", pictures


def _convert_output(output: nbformat.NotebookNode, folder: str, pictures: dict[str, bytes]) -> str:
    """Return an output as Markdown, in the richest form that it has. Add its picture, which links to itself."""
    if output.output_type == "stream":
        return _fence(ANSI.sub("", output.text).rstrip(), "text") if output.text.strip() else ""
    forms = output.get("data", {})
    if "text/html" in forms:
        return forms["text/html"]
    if "image/png" in forms:
        name = f"{len(pictures) + 1}.png"
        pictures[name] = base64.b64decode(forms["image/png"])
        return f"[![Output {len(pictures)}]({folder}{name})]({folder}{name})"
    return _fence(forms["text/plain"], "text") if "text/plain" in forms else ""


def _fence(text: str, language: str) -> str:
    ticks = "`" * max([3, *(len(run) + 1 for run in re.findall("`+", text))])
    return f"{ticks}{language}\n{text}\n{ticks}"
