"""Lobe inside the bpy module: builds the extension from this checkout, installs and enables it.

What the tools and the tests run is thereby the extension as a user gets it, in a Blender user folder of its own.
Building takes a second and is done only when a product file has changed.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
PRODUCT = ("blender_manifest.toml", "__init__.py", "addon", "engine")
MODULE = "bl_ext.user_default.lobe"


class SetupError(RuntimeError):
    """Lobe cannot be made ready for Blender; the text says why."""


def enable_lobe() -> None:
    """Build (where needed), install and enable Lobe. To be called before anything imports bpy."""
    if "bpy" not in sys.modules:
        os.environ["BLENDER_USER_RESOURCES"] = str(install())
    elif not os.environ.get("BLENDER_USER_RESOURCES"):
        raise RuntimeError("enable_lobe() must be called before bpy is imported")
    import bpy  # noqa: F401  (makes addon_utils importable)
    import addon_utils  # isort: skip

    def fail(error: Exception) -> None:
        raise SetupError(f"Lobe could not be enabled: {error}") from error

    addon_utils.enable(MODULE, default_set=True, handle_error=fail)


def install() -> Path:
    """A Blender user folder with this checkout's extension in it, installed anew when a product file has changed.

    The folder stays the same for a checkout and a version of Blender, because Numba's cache depends on where the
    kernels lie; the add-on keeps that cache in here too, as in a Blender program.
    """
    user = private_folder(f"blender-{blender_version()}-{_checkout()}")
    extensions = user / "extensions" / "user_default"
    stamp = user / "content"
    content = _content_hash()
    with _lock(user / "lock"):
        if stamp.is_file() and stamp.read_text() == content and (extensions / "lobe").is_dir():
            return user
        stamp.unlink(missing_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            package = Path(folder) / "lobe.zip"
            build(package)
            extension_tool("install-files", "--local-dir", folder, str(package), "--blender-version", blender_version(),
                           "--python-version", "{:d}.{:d}.{:d}".format(*sys.version_info[:3]))  # fmt: skip
            shutil.rmtree(extensions / "lobe", ignore_errors=True)
            extensions.mkdir(parents=True, exist_ok=True)
            shutil.move(Path(folder) / "lobe", extensions / "lobe")
        stamp.write_text(content)
    return user


def clean() -> None:
    """Remove the Blender user folders of this checkout, for any version of Blender, and the wheels of all packages."""
    places = Path(tempfile.gettempdir())
    for folder in (*places.glob(_named(f"blender-*-{_checkout()}")), *places.glob(_named("wheels"))):
        print(f"Removing {folder}")
        shutil.rmtree(folder, ignore_errors=True)


def _checkout() -> str:
    return hashlib.sha1(str(REPOSITORY).encode()).hexdigest()[:8]


def _named(name: str) -> str:
    """Of a folder of this user's in the temporary one."""
    return f"lobe-{name}" + (f"-{os.getuid()}" if hasattr(os, "getuid") else "")


def build(package: Path, source: Path = REPOSITORY) -> None:
    """Build `source` into the extension file `package` with Blender's own tool."""
    extension_tool("build", "--source-dir", str(source), "--output-filepath", str(package))


def validate(package: Path) -> None:
    """Have Blender's own tool check an extension file, its tags among what it checks."""
    tags = next(_bpy().glob("*/scripts/modules/_bpy_internal/extensions/tags.py"))
    extension_tool("validate", "--valid-tags", str(tags), str(package))


def extension_tool(*arguments: str) -> str:
    """Run Blender's command line tool for extensions, which the bpy module carries; gives back what it prints."""
    tool = next(_bpy().glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True)
    if done.returncode:
        raise SetupError(f"Blender's extension tool failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def _bpy() -> Path:
    """The folder of the bpy module, without importing it."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or not spec.submodule_search_locations:
        raise SetupError("the Python package bpy is not installed")
    return Path(spec.submodule_search_locations[0])


def product_files() -> list[Path]:
    """Every file that belongs into the extension."""
    files: list[Path] = []
    for name in PRODUCT:
        path = REPOSITORY / name
        files += path.rglob("*") if path.is_dir() else [path]
    return sorted(f for f in files if f.is_file() and not any(_is_litter(p) for p in f.relative_to(REPOSITORY).parts))


def _is_litter(name: str) -> bool:
    """As the manifest's paths_exclude_pattern has it."""
    return name.startswith(".") or name == "__pycache__"


def _content_hash() -> str:
    digest = hashlib.sha256(sys.version.encode())
    for path in product_files():
        digest.update(path.relative_to(REPOSITORY).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def blender_version() -> str:
    """Of the bpy module, without importing it: "5.0.1"."""
    return importlib.metadata.version("bpy")


def private_folder(name: str) -> Path:
    """A folder of this user's in the system's temporary folder, which nobody else can write to.

    The temporary folder is everybody's: what another user has put there under our name must not be run.
    """
    folder = Path(tempfile.gettempdir()) / _named(name)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise SetupError(f"{str(folder)!r} cannot be made: {error.strerror}") from error
    if hasattr(os, "getuid"):
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
            raise SetupError(f"{str(folder)!r} is not a folder of yours: remove it, or set TMPDIR to another place")
        if status.st_mode & 0o077:
            folder.chmod(0o700)
    return folder


def check_folder(folder: Path) -> None:
    """See that files can be written there, or that it can be made: before the work, and without making it, as the work
    may fail. Raises SetupError."""
    try:
        there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not there.is_dir():
            raise SetupError(f"{str(there)!r} is not a folder")
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise SetupError(f"{str(folder)!r} cannot be written to: {error.strerror}") from error


def make_folder(folder: Path) -> None:
    """For output, where there is none, and say so: a name may be mistyped. Raises OSError."""
    if not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)  # another process may have been quicker
        print(f"Made the folder {folder}", file=sys.stderr)


@contextlib.contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Keeps other processes out. Where there is no fcntl (Windows), nothing does."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
