"""The workflows, the Dockerfile and the citation agree with the files of the project."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
DOCKERFILE = (ROOT / "Dockerfile").read_text()


def read_steps(path: Path) -> list[dict]:
    jobs = yaml.safe_load(path.read_text())["jobs"].values()
    return [step for job in jobs for step in job["steps"]]


def test_all_workflows_are_found():
    assert {path.stem for path in WORKFLOWS} >= {"audit", "docs", "tests", "wheels"}


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_pinned_by_major_version(path):
    used = [step["uses"] for step in read_steps(path) if "uses" in step]
    assert used
    assert [action for action in used if not re.fullmatch(r"[\w-]+/[\w-]+@(release/)?v\d+", action)] == []


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_every_called_target_and_script_exists(path):
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for command in (step["run"] for step in read_steps(path) if "run" in step):
        assert set(re.findall(r"\bmake ([a-z-]+)", command)) <= set(targets)
        for name in re.findall(r"\b(?:scripts|tests)/[\w./-]+", command):
            assert (ROOT / name).exists(), name


def test_only_a_tag_publishes_and_without_a_token():
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "wheels.yml").read_text())["jobs"]
    assert jobs["publish"]["if"] == "startsWith(github.ref, 'refs/tags/v')"
    assert jobs["publish"]["permissions"] == {"id-token": "write"}
    assert set(jobs["publish"]["needs"]) == set(jobs) - {"publish"}
    assert "secrets." not in (ROOT / ".github" / "workflows" / "wheels.yml").read_text()


def test_the_workflow_tries_every_python_of_the_classifiers():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    classified = [c.rpartition(" ")[2] for c in project["classifiers"] if re.search(r":: Python :: 3\.\d+$", c)]
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "wheels.yml").read_text())["jobs"]
    assert jobs["try"]["strategy"]["matrix"]["python"] == classified


def test_the_image_has_the_system_packages_of_the_script():
    script = (ROOT / "scripts" / "system-packages.sh").read_text()
    listed = script.split('libraries="\n')[1].split('"')[0].splitlines()
    driver = re.findall(r"has_egl_driver \|\| miss \"[^\"]+\" (\S+)", script)
    (installed,) = re.findall(r"apt-get install -y --no-install-recommends \\\n(.*?)\\\n", DOCKERFILE, re.DOTALL)
    assert sorted(installed.split()) == sorted([line.split()[1] for line in listed] + driver)


def test_the_image_copies_only_files_that_exist_and_are_not_ignored():
    copied = [words.split()[:-1] for words in re.findall(r"^COPY (.+)$", DOCKERFILE, re.MULTILINE)]
    names = {name for words in copied for name in words}
    assert all((ROOT / name).exists() for name in names)
    assert names == set(re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE))
    assert 'ENTRYPOINT ["tactile-loc"]' in DOCKERFILE


def test_the_citation_agrees_with_the_project():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["cff-version"] == "1.2.0"
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert [a["name"] for a in citation["authors"]] == [a["name"] for a in project["authors"]]
    (paper,) = citation["references"]
    assert {"type", "title", "authors"} <= paper.keys()
    assert paper["title"] in " ".join((ROOT / "README.md").read_text().split())
    for author in paper["authors"]:
        assert author["family-names"] in (ROOT / "README.md").read_text()
