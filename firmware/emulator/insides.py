"""Where a variable of the logger lies in RAM: for states that would take the image hours to come to."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from emulation import FIRMWARE, build

RAM_AT = 0x20000000


def offset_in_app(member: str, image: Path) -> int:
    """Offset in RAM of a member of `app_t`, by the compiler that made the image and the symbols beside it."""
    symbols = build.run(["arm-none-eabi-nm", str(image.with_suffix(".elf"))])
    app = re.search(r"^([0-9a-f]{8}) b app$", symbols, re.MULTILINE)
    if app is None:
        raise RuntimeError("the image has no app")
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "offset.c"
        source.write_text(
            f'#include "app.h"\n#include <stddef.h>\nconst unsigned offset = offsetof(app_t, {member});\n'
        )
        includes = [f"-I{FIRMWARE / part}" for part in ("core", "drivers", "app")] + [f"-I{image.parent / 'fatfs'}"]
        command = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-S", "-o", "-", *includes, str(source)]
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    offset = re.search(r"\.word\s+(\d+)", text)
    return int(app[1], 16) - RAM_AT + (int(offset[1]) if offset else 0)


def resolve(line: str, image: Path) -> str:
    """An action of a case as world.c reads it: `poke MEMBER VALUE` with a place instead of a name."""
    words = line.split()
    if words[0] != "poke":
        return line
    return f"poke {offset_in_app(words[1], image) << 32 | int(words[2])}"
