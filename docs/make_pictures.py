"""Render the pictures of the documentation: `.venv/bin/python docs/make_pictures.py [NAME]...`

Small, and with many samples, because noise is what makes a PNG large. They end up in docs/images/. The lamps' mirror
images throw caustics, which are specks for long: there indirect light is clamped.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import OpenImageIO as oiio

ROOT = Path(__file__).resolve().parent.parent
LIMIT = 150_000  # bytes of a picture

# Scene -> options of tools/render.py.
PICTURES = {
    "plates_phong": "--resolution 384x256 --samples 512",
    "cornell_diffuse": "--resolution 256x256 --samples 512",
    "lamps": "--resolution 300x200 --samples 512 --set scene.lobe.clamp_indirect=1",
    "world": "--resolution 300x200 --samples 512",
    "instances": "--resolution 300x200 --samples 256",
    "many_lights": "--resolution 300x200 --samples 1024",
}


def strip(picture: Path) -> None:
    """Without Blender's metadata, which holds the path of the file that was rendered."""
    pixels = oiio.ImageBuf(str(picture)).get_pixels(oiio.UINT8)[..., :3]
    bare = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, oiio.UINT8)
    bare.attribute("png:compressionLevel", 9)
    output = oiio.ImageOutput.create(str(picture))
    if not (output and output.open(str(picture), bare) and output.write_image(pixels) and output.close()):
        sys.exit(f"{picture} cannot be written: {oiio.geterror()}")


def main(names: list[str]) -> None:
    unknown = [name for name in names if name not in PICTURES]
    if unknown:
        sys.exit(f"no such picture: {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    for name in names or PICTURES:
        picture = ROOT / "docs" / "images" / f"{name}.png"
        command = [sys.executable, "tools/render.py", f"sample_blends/{name}.blend", *PICTURES[name].split()]
        command += ["-o", str(picture)]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        strip(picture)
        size = picture.stat().st_size
        print(f"{picture.relative_to(ROOT)}  {size / 1000:.0f} kB")
        if size > LIMIT:
            sys.exit(f"{name}.png is larger than {LIMIT / 1000:.0f} kB: give it fewer pixels or more samples")


if __name__ == "__main__":
    main(sys.argv[1:])
