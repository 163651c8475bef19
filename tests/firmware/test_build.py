"""The image for the board: it builds, keeps its budget, and its registers agree with the maker's device description."""

import fcntl
import graphlib
import os
import re
import struct
import subprocess
import sys
import xml.etree.ElementTree as ET
from importlib import resources
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
PORT = FIRMWARE / "port" / "stm32f103"
OUT = FIRMWARE.parent / "build" / "firmware"
sys.path.insert(0, str(FIRMWARE))
import build  # noqa: E402
import stack_usage  # noqa: E402


@pytest.fixture(scope="session")
def image():
    """Folder of the built image, one for all processes of the run."""
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT.parent / "firmware.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            build.find_tools()
            fatfs = build.find_fatfs(build.FATFS_CACHE)
        except build.MissingError as error:
            pytest.skip(f"needs system package gcc-arm-none-eabi, and FatFs: {error}")
        build.compile_image(OUT, fatfs)
    return OUT


def symbols(image):
    rows = (row.split() for row in build.run(["arm-none-eabi-nm", str(image / "logger.elf")]).splitlines())
    return {row[-1]: int(row[0], 16) for row in rows if len(row) == 3}


# ---- the image ----


def test_image_keeps_its_budget(image, capsys):
    sizes = build.measure(image)
    assert build.report(sizes)
    assert "TOO MUCH" not in capsys.readouterr().out
    assert sizes.worst_stack > 1000, "less than the deepest call is known to need"


def test_readme_has_what_the_image_takes(image):
    sizes = build.measure(image)
    rows = re.findall(
        r"^\| (flash|RAM|stack)[^|]*\| ([\d,]+) \| ([\d,]+) \|$", (FIRMWARE / "README.md").read_text(), re.M
    )
    stated = {name: (int(taken.replace(",", "")), int(of.replace(",", ""))) for name, taken, of in rows}
    assert {name: of for name, (_, of) in stated.items()} == {
        "flash": build.FLASH_BYTES,
        "RAM": build.RAM_BYTES,
        "stack": sizes.stack_reserved,
    }
    for name, taken in (("flash", sizes.flash), ("RAM", sizes.ram), ("stack", sizes.worst_stack)):
        assert stated[name][0] == pytest.approx(taken, rel=0.01)  # another compiler's differs by less


@pytest.mark.parametrize(
    "sizes",
    [
        build.Sizes(65537, 1000, 2000, {"main": 10}),
        build.Sizes(1000, 18481, 2000, {"main": 10}),
        build.Sizes(1000, 1000, 2000, {"main": 1900, "priority 1": 101}),
    ],
)
def test_budget_that_is_exceeded_is_reported(sizes, capsys):
    assert not build.report(sizes)
    assert "TOO MUCH" in capsys.readouterr().out


def test_image_has_no_heap(image):
    heap = {"malloc", "free", "calloc", "realloc", "_sbrk", "sbrk", "_malloc_r"}
    assert not heap & symbols(image).keys()


def test_vector_table_points_to_the_handlers(image):
    table = struct.unpack("<59I", (image / "logger.bin").read_bytes()[: 59 * 4])
    known = symbols(image)
    assert table[0] == known["_stack_top"]
    assert table[1] == known["Reset_Handler"] | 1
    for name, number in interrupt_numbers().items():
        if name != "COUNT":
            handler = {"EXTI0": "EXTI0", "TIM2": "TIM2"}.get(name, name.replace("DMA1_CHANNEL", "DMA1_Channel"))
            assert table[16 + number] == known[f"{handler}_IRQHandler"] | 1


def test_hex_and_bin_are_the_same_image(image):
    raw = bytearray()
    for line in (image / "logger.hex").read_text().splitlines():
        record = bytes.fromhex(line[1:])
        assert sum(record) % 256 == 0
        if record[3] == 0:
            raw += record[4:-1]
    assert bytes(raw) == (image / "logger.bin").read_bytes()


def test_every_handler_is_in_the_sum_of_the_stack():
    named = {name for handlers in stack_usage.HANDLERS.values() for name in handlers}
    sources = "".join(path.read_text() for path in PORT.glob("*.c"))
    assert named == set(re.findall(r"^void (\w+_IRQHandler)\(void\)\n\{", sources, re.MULTILINE))


def test_recursion_and_unknown_functions_are_errors():
    loop = stack_usage.CallGraph({"main": 8, "other": 8}, {"main": frozenset(["other"]), "other": frozenset(["main"])})
    with pytest.raises(stack_usage.StackError, match="recursion"):
        stack_usage.deepest(loop, "main")
    with pytest.raises(stack_usage.StackError, match="no known stack"):
        stack_usage.deepest(stack_usage.CallGraph({"main": 8}, {"main": frozenset(["printf"])}), "main")
    with pytest.raises(stack_usage.StackError, match="pointer"):
        stack_usage.deepest(stack_usage.CallGraph({"main": 8}, {"main": frozenset(["pointer in x.c"])}), "main")


# ---- FatFs ----


def test_fatfs_with_other_bytes_is_not_taken(tmp_path):
    for name in build.FATFS_SHA256:
        (tmp_path / name).write_text("not what was asked for")
    assert not build.has_fatfs(tmp_path)


def test_fatfs_is_not_in_the_repository():
    for name in build.FATFS_SHA256:
        assert not [path for path in FIRMWARE.rglob(name) if "build" not in path.parts]


# ---- the registers, against modm-devices ----


@pytest.fixture(scope="session")
def device():
    """Drivers of the STM32F103C8 by type."""
    path = resources.files("modm_devices") / "resources" / "devices" / "stm32" / "stm32f1-01_02_03-8_b.xml"
    return ET.fromstring(path.read_text())


def is_ours(element):
    """Whether an element is there in an STM32F103 in the 48-pin package with 64 KB."""
    conditions = (("device-name", "03"), ("device-pin", "c"), ("device-size", "8"))
    return all(wanted in element.get(key, wanted).split("|") for key, wanted in conditions)


def interrupt_numbers():
    header = (PORT / "stm32f103.h").read_text()
    return {name: int(number) for name, number in re.findall(r"IRQ_(\w+) = (\d+),", header)}


def test_interrupt_numbers_agree(device):
    vectors = {row.get("name").upper(): int(row.get("position")) for row in device.iter("vector") if is_ours(row)}
    ours = interrupt_numbers()
    assert ours.pop("COUNT") == max(vectors.values()) + 1
    assert ours
    for name, number in ours.items():
        assert vectors[name] == number


def test_dma_channels_agree(device):
    channels = {
        (signal.get("driver"), signal.get("instance"), signal.get("name")): int(channel.get("position"))
        for channel in device.iter("channel")
        if channel.get("position")
        for signal in channel.iter("signal")
        if is_ours(signal)
    }
    header = (PORT / "stm32f103.h").read_text()
    ours = re.findall(r"#define DMA_(SPI|USART)(\d)_(RX|TX) (\d)u", header)
    assert len(ours) == 6
    for driver, instance, direction, channel in ours:
        assert channels[driver.lower(), instance, direction.lower()] == int(channel)
    assert len({channel for *_, channel in ours}) == 6, "two streams on one channel"


PINS = {  # as README.md has them wired: what the pin does without remapping
    "a1": ("tim", "2", "ch2"),
    "a2": ("usart", "2", "tx"),
    "a3": ("usart", "2", "rx"),
    "a5": ("spi", "1", "sck"),
    "a6": ("spi", "1", "miso"),
    "a7": ("spi", "1", "mosi"),
    "a9": ("usart", "1", "tx"),
    "b13": ("spi", "2", "sck"),
    "b14": ("spi", "2", "miso"),
    "b15": ("spi", "2", "mosi"),
}


@pytest.mark.parametrize(("pin", "use"), PINS.items())
def test_pins_agree(device, pin, use):
    driver, instance, name = use
    remaps = [
        signal
        for remap in device.iter("remap")
        if (remap.get("driver"), remap.get("instance")) == (driver, instance) and is_ours(remap)
        for group in remap.iter("group")
        if group.get("id") == "0"
        for signal in group.iter("signal")
        if signal.get("name") == name
    ]
    fixed = [
        signal
        for gpio in device.iter("gpio")
        if (gpio.get("port"), gpio.get("pin")) == (pin[0], pin[1:])
        for signal in gpio.iter("signal")
        if (signal.get("driver"), signal.get("instance"), signal.get("name")) == use
    ]
    places = {signal.get("port") + signal.get("pin") for signal in remaps}
    assert places == {pin} or fixed
    assert f"P{pin.upper()}" in (FIRMWARE / "README.md").read_text()


def test_memory_agrees(device):
    memory = {row.get("name"): row for row in device.iter("memory") if is_ours(row)}
    script = (PORT / "stm32f103c8.ld").read_text()
    for region, name, limit in (("FLASH", "flash", build.FLASH_BYTES), ("RAM", "sram1", build.RAM_BYTES)):
        start, kilobytes = re.search(region + r" \(\w+\)\s*: ORIGIN = (\w+), LENGTH = (\d+)K", script).groups()
        assert int(start, 16) == int(memory[name].get("start"), 16)
        assert int(kilobytes) * 1024 == int(memory[name].get("size")) == limit


# ---- what it is built with ----


def test_two_processes_that_miss_a_tool_do_not_install_at_once(tmp_path):
    """As test processes do on a bare machine: apt refuses while another installs, and the tool counts as missing."""
    programs = {
        "apt-get": f"""mkdir {tmp_path}/busy 2>/dev/null || exit 100
sleep 0.5
printf '#!/bin/sh\\n' > {tmp_path}/cppcheck && chmod +x {tmp_path}/cppcheck
echo "$@" >> {tmp_path}/calls
rmdir {tmp_path}/busy
""",
        "sudo": 'shift\nexec "$@"\n',
    }
    for name, lines in programs.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{lines}")
        (tmp_path / name).chmod(0o755)
    ask = "import sys, build; build.find_tool = lambda tool: build.shutil.which(tool, path=sys.argv[1]);"
    ask += "build.find_tools(('cppcheck',))"
    environment = {**os.environ, "TMPDIR": str(tmp_path), "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    command = [sys.executable, "-c", ask, str(tmp_path)]
    both = [subprocess.Popen(command, cwd=FIRMWARE, env=environment) for _ in range(2)]
    assert [process.wait(timeout=60) for process in both] == [0, 0]
    assert len((tmp_path / "calls").read_text().splitlines()) == 1


# ---- the source ----


def test_cppcheck_has_nothing_to_say(image):
    try:
        build.find_tools(("cppcheck",))
    except build.MissingError:
        pytest.skip("needs system package cppcheck")
    includes = ["core", "drivers", "app", "port/stm32f103", str(image / "generated"), str(image / "fatfs")]
    # pointers to the linker's symbols are compared, and the vector table's members are read by the core
    silent = ["*:*/fatfs/*", "comparePointers", "unusedStructMember", "toomanyconfigs", "normalCheckLevelMaxBranches"]
    command = [
        "cppcheck",
        "--std=c11",
        "--enable=warning,performance,portability,style",
        "--error-exitcode=1",
        "--quiet",
    ]
    command += [f"-I{folder}" for folder in includes] + [f"--suppress={name}" for name in silent]
    done = subprocess.run([*command, "core", "drivers", "app", "port"], cwd=FIRMWARE, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def uses_of(texts: dict[str, str]) -> dict[str, set[str]]:
    """Which file uses functions of which other, of sources by name."""
    owners = {
        name: path
        for path, text in texts.items()
        for name in re.findall(r"^\w[\w ]*\b(app_\w+)\([^;]*?\)\n\{", text, re.MULTILINE)
    }
    called = {path: set(re.findall(r"\b(app_\w+)\(", text)) for path, text in texts.items()}
    return {path: {owners[name] for name in names if name in owners} - {path} for path, names in called.items()}


def test_files_of_the_app_use_one_another_in_no_circle():
    texts = {path.name: path.read_text() for path in sorted((FIRMWARE / "app").glob("*.c"))}
    uses = uses_of(texts)
    assert uses["app.c"] >= {"card.c", "imu.c", "recording.c", "journal.c"}
    list(graphlib.TopologicalSorter(uses).static_order())
    texts["journal.c"] += "\nvoid app_more(void)\n{\n    app_step_card(0, 0);\n}\n"
    with pytest.raises(graphlib.CycleError):
        list(graphlib.TopologicalSorter(uses_of(texts)).static_order())
