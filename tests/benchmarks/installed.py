"""Size of the installed package with all that it requires, and the share of Pinocchio with its libraries.

Run: python -m tests.benchmarks.installed
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution

from packaging.requirements import Requirement


def required(name: str, without: str = "", found: set[str] | None = None) -> set[str]:
    """Return the names of a distribution and of all that it requires here, but for one and what only that requires."""
    found = set() if found is None else found
    try:
        needs = distribution(name).requires or []
    except PackageNotFoundError:
        return found
    found.add(name)
    for text in needs:
        need = Requirement(text)
        own = need.name.lower()
        if own not in {*found, without} and (need.marker is None or need.marker.evaluate({"extra": ""})):
            required(own, without, found)
    return found


def size(names: set[str]) -> float:
    """Return the size of the files of some distributions [MB]."""
    files = (distribution(name).locate_file(file) for name in names for file in distribution(name).files or [])
    return sum(path.stat().st_size for path in {str(one): one for one in files}.values() if path.is_file()) / 1e6


def main() -> None:
    """Print both sizes."""
    every = required("postproc")
    rest = required("postproc", without="pin")
    print(f"installed {size(every):.0f} MB, of it Pinocchio and its libraries {size(every - rest):.0f} MB")
    print("with Pinocchio only:", ", ".join(sorted(every - rest)))


if __name__ == "__main__":
    main()
