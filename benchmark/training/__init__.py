"""Training of restorers that are networks: `std-train`."""

from importlib.util import find_spec

from std_toolkit.errors import ToolkitError


def check_installed() -> None:
    """Check that the packages of the extra `train` are installed.

    Raises:
        ToolkitError: one is missing.
    """
    missing = [name for name in ("torch", "pytorch_lightning", "kornia") if not find_spec(name)]
    if missing:
        raise ToolkitError(
            f"training needs {', '.join(missing)}", hint="pip install 'std-toolkit[train]'"
        )
