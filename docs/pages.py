"""A hook of MkDocs: pages that the navigation does not name come under "The robot"."""

from pathlib import Path


def on_config(config):
    named = str(config["nav"])
    pages = sorted(path.name for path in Path(config["docs_dir"]).glob("*.md"))
    robot = next(entry["The robot"] for entry in config["nav"] if "The robot" in entry)
    robot += [page for page in pages if page not in named]
    return config
