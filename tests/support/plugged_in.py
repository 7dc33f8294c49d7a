"""Distributions that are installed for a test only: a module and its entry points in a folder of `sys.path`."""


def write_distribution(folder, name, groups, code="", version="1.0"):
    """Write a distribution with one module into a folder; `groups`: group -> lines of entry points."""
    module = name.replace("-", "_")
    info = folder / f"{module}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [f"[dehyst.{group}]\n{text}\n" for group, text in groups.items()]
    (info / "entry_points.txt").write_text("\n".join(lines))
    (folder / f"{module}.py").write_text(code)
