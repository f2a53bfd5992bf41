"""README.md: its tables are what the results files say, and its code runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_tables_are_those_of_the_results_files():
    run = subprocess.run(
        [sys.executable, ROOT / "scripts" / "readme.py", "--check"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_code_runs(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {})


def test_every_picture_and_path_exists():
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    scripts = re.findall(r"(scripts/[a-z0-9_]+\.(?:py|sh))", README)
    assert pictures
    for path in {*pictures, *scripts}:
        assert (ROOT / path).exists(), path
