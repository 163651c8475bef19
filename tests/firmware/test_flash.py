"""The tool that is there writes the image, and a release has checksums that hold."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
sys.path.insert(0, str(FIRMWARE))
import flash  # noqa: E402


@pytest.mark.parametrize(
    ("tools", "port", "wanted"),
    [
        (["st-flash", "openocd"], None, ["st-flash", "--reset", "write", "0x08000000"]),
        (["openocd", "stm32flash"], None, ["openocd", "target/stm32f1x.cfg"]),
        (["st-flash", "stm32flash"], "/dev/ttyUSB3", ["stm32flash", "-v", "/dev/ttyUSB3"]),
        (["stm32flash"], None, None),
        ([], None, None),
    ],
)
def test_the_tool_that_is_there_is_used(monkeypatch, tools, port, wanted):
    monkeypatch.setattr(flash.shutil, "which", lambda name: f"/bin/{name}" if name in tools else None)
    monkeypatch.setattr(flash, "find_port", lambda: None)
    found = flash.command(Path("image"), port)
    assert (
        found is None if wanted is None else found is not None and set(wanted) <= set(found) and found[0] == wanted[0]
    )


def test_checksums_of_a_release_hold_and_notice_a_changed_byte(tmp_path):
    if shutil.which("sha256sum") is None:
        pytest.skip("needs system package coreutils")
    image, out = tmp_path / "image", tmp_path / "release"
    image.mkdir()
    for name in ("logger.bin", "logger.hex"):
        (image / name).write_bytes(name.encode())
    assert [path.name for path in flash.release(image, out)] == ["logger.bin", "logger.hex", "SHA256SUMS"]
    check = ["sha256sum", "--check", "SHA256SUMS"]
    assert subprocess.run(check, cwd=out, capture_output=True).returncode == 0
    (out / "logger.bin").write_bytes(b"logger.bim")
    assert subprocess.run(check, cwd=out, capture_output=True).returncode != 0
