"""Render the pictures of the documentation: `.venv/bin/python docs/make_pictures.py [NAME]...`

Small, and with many samples, because noise is what makes a PNG large. They end up in docs/images/. Mirrors throw
caustics, which are specks for long: there indirect light is clamped.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import OpenImageIO as oiio

ROOT = Path(__file__).resolve().parent.parent
LIMIT = 150_000  # bytes of a picture

# Scene -> options of tools/render.py.
PICTURES = {
    "plates_phong": "--resolution 384x256 --samples 1024 --set scene.lobe.clamp_indirect=1",
    "cornell_diffuse": "--resolution 256x256 --samples 512 --set scene.view_settings.exposure=1",
    "lamps": "--resolution 300x200 --samples 2048 --set scene.lobe.clamp_indirect=1",
    "world": "--resolution 300x200 --samples 1024 --set scene.lobe.clamp_indirect=1",
    "instances": "--resolution 300x200 --samples 256",
    "many_lights": "--resolution 300x200 --samples 2048",
}
COMPARISON = "comparison"
COMPARED = "sample_blends/many_lights.blend --resolution 252x168 --samples 16"


def read(picture: Path) -> np.ndarray:
    return oiio.ImageBuf(str(picture)).get_pixels(oiio.UINT8)[..., :3]


def write(picture: Path, pixels: np.ndarray) -> None:
    """Without Blender's metadata, which holds the path of the file that was rendered."""
    bare = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.UINT8)
    bare.attribute("png:compressionLevel", 9)
    output = oiio.ImageOutput.create(str(picture))
    if not (output and output.open(str(picture), bare) and output.write_image(pixels) and output.close()):
        sys.exit(f"{picture} cannot be written: {oiio.geterror()}")


def run(tool: str, options: str, output: Path) -> None:
    command = [sys.executable, f"tools/{tool}.py", *options.split(), "-o", str(output)]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def compared() -> np.ndarray:
    """Lobe's picture, Cycles', and how they differ, side by side."""
    with TemporaryDirectory() as folder:
        run("compare", COMPARED, Path(folder))
        return np.concatenate([read(Path(folder, f"{name}.png")) for name in ("lobe", "cycles", "difference")], axis=1)


def rendered(name: str) -> np.ndarray:
    with TemporaryDirectory() as folder:
        run("render", f"sample_blends/{name}.blend {PICTURES[name]}", Path(folder, "picture.png"))
        return read(Path(folder, "picture.png"))


def main(names: list[str]) -> None:
    known = [*PICTURES, COMPARISON]
    unknown = [name for name in names if name not in known]
    if unknown:
        sys.exit(f"no such picture: {', '.join(unknown)}; there are {', '.join(known)}")
    for name in names or known:
        picture = ROOT / "docs" / "images" / f"{name}.png"
        write(picture, compared() if name == COMPARISON else rendered(name))
        size = picture.stat().st_size
        print(f"{picture.relative_to(ROOT)}  {size / 1000:.0f} kB")
        if size > LIMIT:
            sys.exit(f"{name}.png is larger than {LIMIT / 1000:.0f} kB: give it fewer pixels or more samples")


if __name__ == "__main__":
    main(sys.argv[1:])
