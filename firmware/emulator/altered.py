"""Images of altered sources: a copy of the firmware in which texts are replaced, built again from what has changed."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from emulation import FIRMWARE, build


@dataclass(frozen=True)
class Edit:
    """A text of a source file, which must stand there once, and what stands there instead."""

    file: str
    old: str
    new: str


@dataclass(frozen=True)
class Workshop:
    """A copy of the sources in `folder`, configured; each image takes what compiling its edits takes."""

    folder: Path

    def __post_init__(self) -> None:
        """Copy and configure. build.MissingError without FatFs."""
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(FIRMWARE, self.source, ignore=shutil.ignore_patterns("emulator", "__pycache__"))
        toolchain = self.source / "port" / "stm32f103" / "toolchain.cmake"
        fatfs = build.find_fatfs(build.FATFS_CACHE).resolve()
        options = ["-G", "Unix Makefiles", f"-DCMAKE_TOOLCHAIN_FILE={toolchain}", f"-DFATFS_DIR={fatfs}"]
        build.run(["cmake", "-S", str(self.source), "-B", str(self.folder / "build"), *options])

    @property
    def source(self) -> Path:
        """The copy."""
        return self.folder / "firmware"

    def build(self, edits: Sequence[Edit]) -> Path:
        """The image with these edits alone. RuntimeError if a text is not there once, or does not compile."""
        names = {edit.file for edit in edits}
        texts = {name: (self.source / name).read_text() for name in names}
        try:
            for edit in edits:
                path = self.source / edit.file
                if path.read_text().count(edit.old) != 1:
                    raise RuntimeError(f"{edit.file}: the place for an edit is not there once: {edit.old}")
                path.write_text(path.read_text().replace(edit.old, edit.new))
            build.run(["cmake", "--build", str(self.folder / "build"), "--parallel", "2"])
        finally:
            for name, text in texts.items():
                (self.source / name).write_text(text)
        return self.folder / "build" / "logger.bin"
