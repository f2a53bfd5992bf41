"""What the site has beyond its Markdown: executed examples, pages of the public names, the pictures of the results.

MkDocs calls the `on_` functions (mkdocs.yml). Any failure stops the build.
"""

import inspect
import itertools
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File
from PIL import Image

import deep_contact
from deep_contact import lazy

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs"))
import reference  # noqa: E402
import tables  # noqa: E402

GALLERY = ROOT / "docs" / "gallery"
PICTURES = (".png", ".gif")
PLAYS = ".html"
TIMEOUT_S = 3600
LONG = () if os.environ.get("DEEP_CONTACT_GALLERY") != "quick" else (
    "biaxial", "cluster", "drum_trade", "feed_hopper", "hopper_trade", "one_sweep", "photographed_packing",
    "plain_keras", "predict_impulses", "redraw_figure", "train_network",
)  # fmt: skip
"""Programs that take most of the time: with DEEP_CONTACT_GALLERY=quick, as in CI, their pages show the code alone."""
PATHS = {"PYTHONPATH": str(ROOT), "TF_CPP_MIN_LOG_LEVEL": "3"}
PLACES = {}
"""Public name -> where it is: of a module its own name."""
for _public, (_module, _name) in lazy.homes(deep_contact.__file__).items():
    _found = getattr(deep_contact, _public)
    PLACES[_public] = _found.__name__ if inspect.ismodule(_found) else f"{_module}.{_name}"
MODULES = [_public for _public, _place in PLACES.items() if inspect.ismodule(getattr(deep_contact, _public))]
PAGES = {_public: f"api/{_public}.md" for _public in MODULES}
"""Public name -> the page that describes it: of its task, or a module's own."""
for _task, _names in reference.TASKS.items():
    PAGES = {_name: f"api/{reference.page_of(_task)}.md" for _name in _names.split()} | PAGES
if sorted(PAGES) != sorted(PLACES):
    raise PluginError(f"docs/reference.py: expected each public name once, got {sorted(PAGES.keys() ^ PLACES.keys())}")
MODELS = ROOT / "models"
"""Its README.md is a page of the site, `models.md`."""
THUMBNAIL = 280
"""Width of the pictures in the index of results, pixels."""
_pictures, _titles = {}, {}
_work = tempfile.TemporaryDirectory()


def on_config(config):
    """Add the examples, in the order of the gallery's index, and the public names to the navigation."""
    tabs = {name: pages for tab in config.nav for name, pages in tab.items()}
    tabs["Use"].append({"Gallery": ["gallery/index.md", *(f"gallery/{name}.md" for name in _order())]})
    tasks = [{task: f"api/{reference.page_of(task)}.md"} for task in reference.TASKS]
    modules = [{f"dc.{name}": PAGES[name]} for name in sorted(MODULES)]
    tabs["Reference"].insert(0, {"Public names": ["api/index.md", *tasks, {"Modules": modules}]})
    config.theme.static_templates.discard("404.html")  # its links are right on a server alone, at the root
    return config


def on_files(files, config):
    """Run the examples, and add their pages, those of the API, and the pictures of the results."""
    first, *others = _order()
    pages = [_example(first)]  # alone: it compiles what all of them need
    with ThreadPoolExecutor(2) as pool:
        pages += pool.map(_example, others)
    for name, (page, pictures) in zip([first, *others], pages):
        _pictures[name] = [path for path in pictures if path.suffix in PICTURES]
        files.append(File.generated(config, f"gallery/{name}.md", content=page))
        for path in pictures:
            files.append(File.generated(config, f"gallery/{name}/{path.name}", abs_src_path=str(path)))
    for task, names in reference.TASKS.items():
        public = [name for name in names.split() if name not in MODULES]
        blocks = "".join(f"\n::: {PLACES[name]}\n" for name in public)
        content = f"# {task}\n\n{_table_of(names.split())}{blocks}"
        files.append(File.generated(config, f"api/{reference.page_of(task)}.md", content=content))
    for name in MODULES:
        files.append(File.generated(config, PAGES[name], content=f"# dc.{name}\n\n::: {PLACES[name]}\n{_handed_on(name)}"))
    files.append(File.generated(config, "api/index.md", content=_public_names()))
    files.append(File.generated(config, "models.md", content=_models()))
    for path in MODELS.glob("*.png"):
        files.append(File.generated(config, f"models/{path.name}", abs_src_path=str(path)))
    for path in (ROOT / "data" / "reference").glob("*.png"):
        files.append(File.generated(config, f"reference/{path.name}", abs_src_path=str(path)))
        small = Path(_work.name) / path.name
        with Image.open(path) as picture:
            picture.thumbnail((2 * THUMBNAIL, 2 * THUMBNAIL))
            picture.save(small)
        files.append(File.generated(config, f"thumbnails/{path.name}", abs_src_path=str(small)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn links that are right in the repository into links of the site; add the gallery's pictures, and what is old."""
    if page.file.src_uri in reference.SYNONYMS:
        page.meta["tags"] = reference.SYNONYMS[page.file.src_uri].split(", ")
    if page.file.src_uri in [path.name for path in tables.PAGES]:
        markdown = f"{markdown}\n{tables.old_on(page.file.src_uri, markdown)}"
    if page.file.src_uri == "gallery/index.md":
        shown = [(_titles[name], found[0].name, name) for name, found in _pictures.items() if found]
        cells = (f"[![]({name}/{file}){{ width=300 }}<br>{title}]({name}.md)" for title, file, name in shown)
        rows = "".join(f"| {' | '.join(row)} |\n" for row in itertools.zip_longest(*[cells] * 2, fillvalue=""))
        markdown = markdown.replace("\n## ", f"\n| | |\n| --- | --- |\n{rows}\n## ", 1)
    if page.file.src_uri == "results.md":
        small = rf"[![\1](thumbnails/\2){{ width={THUMBNAIL} }}<br>\1](reference/\2)"
        markdown = re.sub(r"\[(T?[ .\d]+)\]\(\.\./data/reference/(\w+\.png)\)", small, markdown)
    markdown = re.sub(r"\(((?:gallery/)?\w+)\.py\)", r"(\1.md)", markdown)
    markdown = markdown.replace("](../deep_contact/__init__.py)", "](api/index.md)")
    markdown = markdown.replace("](../models/README.md", "](models.md").replace("](../data/reference/", "](reference/")
    outside = re.findall(r"\]\((\.\./[^)]*)\)", markdown) if "/" not in page.file.src_uri else ()
    if outside:  # MkDocs does not warn of it
        raise PluginError(f"{page.file.src_uri}: expected links to pages of the site, got {', '.join(outside)}")
    return markdown


def _models() -> str:
    """The page of the networks: models/README.md without the entries that stand before its title."""
    text = (MODELS / "README.md").read_text(encoding="utf-8")
    text = text[text.index("\n# Models\n") :]
    return re.sub(r"\]\((\w+\.png)\)", r"](models/\1)", text)


def _handed_on(name: str) -> str:
    """What a module imports when it is first used, as blocks, but for what has its place on the page of a task."""
    module = getattr(deep_contact, name)
    homes = lazy.homes(module.__file__) if hasattr(module, "__getattr__") else {}
    places = [
        f"{origin}.{of}"
        for public, (origin, of) in homes.items()
        if not inspect.ismodule(getattr(module, public))
    ]
    return "".join(f"\n::: {place}\n" for place in places if place not in PLACES.values())


def _order() -> list[str]:
    """The examples in the order in which the gallery's index links them."""
    linked = list(dict.fromkeys(re.findall(r"\((\w+)\.py\)", (GALLERY / "index.md").read_text(encoding="utf-8"))))
    found = sorted(path.stem for path in GALLERY.glob("*.py"))
    if sorted(linked) != found:
        raise PluginError(f"docs/gallery/index.md: expected links to {found}, got {linked}")
    return linked


def _public_names() -> str:
    """The page that lists what `import deep_contact` offers, with links to where it is described."""
    parts = [f"\n## {task}\n\n{_table_of(names.split())}" for task, names in reference.TASKS.items()]
    return f"# Public names\n\nAfter `import deep_contact as dc`, by task:\n{''.join(parts)}"


def _table_of(names: list[str]) -> str:
    """A table of public names, with links to where they are described, and what they are."""
    rows = []
    for name in names:
        found = getattr(deep_contact, name)
        described = found if inspect.ismodule(found) or hasattr(found, "__qualname__") else type(found)
        first = inspect.getdoc(described).partition("\n\n")[0].replace("\n", " ").replace("*", r"\*")
        rows.append(f"| [`dc.{name}`]({Path(PAGES[name]).name}#{PLACES[name]}) | {first} |\n")
    return f"| Name | |\n| --- | --- |\n{''.join(rows)}"


def _example(name: str) -> tuple[str, list[Path]]:
    """Run an example in an empty folder. Returns its page, and the pictures and the pages of runs that it wrote."""
    path, folder = GALLERY / f"{name}.py", Path(_work.name) / name
    folder.mkdir()
    output = "" if name in LONG else _run(path, folder)
    _, docstring, code = path.read_text(encoding="utf-8").split('"""', 2)
    title, _, text = docstring.partition("\n")
    pictures = sorted(found for found in folder.iterdir() if found.suffix in PICTURES)
    pages = sorted(found for found in folder.iterdir() if found.suffix == PLAYS)
    shown = "\n".join(f"![{found.stem}]({name}/{found.name})" for found in pictures)
    style = "width:100%;height:640px;border:1px solid #c8c8c8"
    for found in pages:
        shown += f'\n\n<iframe src="{name}/{found.name}" title="{found.stem}, which plays" style="{style}"></iframe>'
    printed = f"It prints\n\n```text\n{output}\n```\n" if output else ""
    _titles[name] = title.rstrip(".")
    page = f"# {title.rstrip('.')}\n{text}\n```python\n{code.strip()}\n```\n\n{shown}\n\n{printed}"
    return f"{page}\nThe file is `docs/gallery/{name}.py`.\n", pictures + pages


def _run(path: Path, folder: Path) -> str:
    """Run a program in this folder. Returns what it prints."""
    environment = os.environ | PATHS | {"CUDA_VISIBLE_DEVICES": ""}
    options = {"capture_output": True, "text": True, "timeout": TIMEOUT_S, "check": False}
    try:
        run = subprocess.run([sys.executable, path], cwd=folder, env=environment, **options)
    except subprocess.TimeoutExpired:
        hint = "`deep-contact warm-up` compiles ahead, on all cores"
        raise PluginError(f"docs/gallery/{path.name}: expected an end within {TIMEOUT_S} s, got none; {hint}") from None
    if run.returncode:
        raise PluginError(f"docs/gallery/{path.name} failed:\n{run.stderr}")
    return run.stdout.rstrip()
