"""Parts of the site that are made from the code: the reference of the Python API and the table of parameters."""

import beltrami_cli
from beltrami_cli.cli.manual import parameter_table


def api_reference() -> str:
    """Ask mkdocstrings for every public name; fields of settings are in the table of parameters."""
    lines = []
    for name in sorted(beltrami_cli.__all__, key=str.lower):
        lines += [f"::: beltrami_cli.{name}", ""]
        if name.endswith("Settings") or name == "KernelParameters":
            lines[-1:] = ["    options: {members: false}", ""]
    return "\n".join(lines)


ADDED = {"api.md": api_reference, "parameters.md": parameter_table}


def on_page_markdown(markdown, page, **_):
    """Add the generated part to the end of a page."""
    made = ADDED.get(page.file.src_uri)
    return markdown if made is None else f"{markdown}\n{made()}"
