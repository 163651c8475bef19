"""The port's register header as a compiler lays it out, and what others say of the same registers.

Three strangers are asked, each fetched by its hash into build/registers and none of them kept in the repository:
the maker's SVD file as a debugger ships it (addresses, offsets, bit fields), the peripheral access crate made from the
corrected SVD (what a field's values mean), and a loader's table (the address of the serial number).
"""

import io
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import build

WHEELS = {
    "pyocd-0.46.0-py3-none-any.whl": "f37c1ef65a1e78b42c9bccf4f34fbde98c4ea225e87534ee872e324aae230ba5",
    "stm32loader-0.7.1-py3-none-any.whl": "47089d32b3fb8b84c197ef379f5bef30fcee691e4f0bf547144ab43127fed987",
}
DEBUGGER, LOADER = WHEELS
CRATE, CRATE_VERSION = "stm32f1", "0.16.0"
CRATE_SHA256 = "8f2b32d5afdbd179dbfa05ad835e4623fb3790c187c2a8d6301eff1507b2c6c9"
CHANNELS = range(1, 8)


# ---- our header ----


@dataclass(frozen=True)
class Header:
    """Addresses by register ("RCC.CR"), values by constant ("RCC_CR_HSEON", "DMA_TC(3)"), bits that
    gpio_configure() touches in both configuration registers of a port by pin."""

    registers: dict[str, int]
    constants: dict[str, int]
    pins: dict[int, int] = field(default_factory=dict)


ARGUMENTS = {  # of macros with one argument, the values it may have
    "RCC_CFGR_PLLMUL": range(2, 17),
    "DMA_CCR_PRIORITY": range(4),
    "DMA_FLAGS": CHANNELS,
    "DMA_TC": CHANNELS,
    "DMA_TE": CHANNELS,
    "SPI_CR1_BR": range(8),
}
SINGLE_REGISTERS = {  # macros that are a register by themselves
    "FLASH_ACR": {"FLASH.ACR": "FLASH_ACR"},
    "SCB_AIRCR": {"SCB.AIRCR": "SCB_AIRCR"},
    "SCB_VTOR": {"SCB.VTOR": "SCB_VTOR"},
    "SCB_CFSR": {"SCB.CFSR": "SCB_CFSR"},
    "UNIQUE_ID": {"UID": "*UNIQUE_ID"},
    "NVIC_ISER": {f"NVIC.ISER{n}": f"NVIC_ISER({n})" for n in range(2)},
    "NVIC_IPR": {f"NVIC.IPR[{irq}]": f"NVIC_IPR({irq})" for irq in range(43)},
}


def _macros(text: str) -> list[tuple[str, bool, str]]:
    """Name, whether it has an argument, and body of each macro that has one."""
    rows = re.findall(r"^#define (\w+)(\(\w+\))? (.+?)(?: */\*.*)?$", text, re.MULTILINE)
    return [(name, bool(argument), body) for name, argument, body in rows]


def _members(text: str) -> dict[str, dict[str, str]]:
    """Registers of each struct: name as the maker numbers it, and how C reaches it."""
    structs: dict[str, dict[str, str]] = {}
    for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", text, re.DOTALL):
        members: dict[str, str] = {}
        for kind, row in re.findall(r"(\w+) (\w[^;]*);", body):
            for member, count in re.findall(r"(\w+)(?:\[(\d+)\])?", row):
                for n in range(int(count or 1)):
                    path, number = (f"{member}[{n}]", str(n + 1)) if count else (member, "")
                    if kind in structs:
                        members |= {f"{inner}{number}": f"{path}.{to}" for inner, to in structs[kind].items()}
                    elif member != "reserved":
                        members[f"{member}{number}"] = path
        structs[name] = members
    return structs


def _program(text: str) -> str:
    """C that prints every address and value of the header."""
    structs = _members(text)
    rows = []
    for name, has_argument, body in _macros(text):
        block = re.match(r"\(\((\w+_t) \*\)", body)
        if block:
            rows += [("register", f"{name}.{to}", f"&{name}->{path}") for to, path in structs[block[1]].items()]
        elif name in SINGLE_REGISTERS:
            rows += [("register", to, f"&{path}") for to, path in SINGLE_REGISTERS[name].items()]
        elif has_argument:
            rows += [("constant", f"{name}({n})", f"{name}({n}u)") for n in ARGUMENTS[name]]
        else:
            rows.append(("constant", name, name))
    prints = [f'    printf("{kind} {name} %lx\\n", (unsigned long)({value}));' for kind, name, value in rows]
    pins = """
    for (unsigned pin = 0; pin < 16; pin++) {
        gpio_t port = {0};
        gpio_configure(&port, pin, 15);
        printf("pin %u %lx\\n", pin, (unsigned long)port.CRL | (unsigned long)port.CRH << 32);
    }"""
    return "\n".join(['#include "stm32f103.h"', "#include <stdio.h>", "int main(void)", "{", *prints, pins, "}"])


def read_header(text: str, compiler: str, folder: Path) -> Header:
    """Compile and run a program that tells what the header's text means."""
    (folder / "stm32f103.h").write_text(text)
    (folder / "tell.c").write_text(_program(text))
    build.run([compiler, "-w", "-o", str(folder / "tell"), str(folder / "tell.c")])
    found: dict[str, dict[str, int]] = {"register": {}, "constant": {}, "pin": {}}
    for row in build.run([str(folder / "tell")]).splitlines():
        kind, name, value = row.split()
        found[kind][name] = int(value, 16)
    return Header(found["register"], found["constant"], {int(pin): bits for pin, bits in found["pin"].items()})


# ---- the strangers ----


@dataclass(frozen=True)
class Maker:
    """Addresses by register, masks of fields by register and name, values by "file.ENUM.Variant"."""

    registers: dict[str, int]
    fields: dict[str, dict[str, int]]
    values: dict[str, int]
    reset_request: int
    priority_bits: int


def fetch_wheels(folder: Path) -> None:
    """Fetch both wheels unless they are there; RuntimeError if they cannot be had."""
    for name, sha256 in WHEELS.items():
        if not (folder / name).is_file() or build.sha256(folder / name) != sha256:
            build.download("==".join(name.split("-")[:2]), sha256, folder)


def fetch_crate(folder: Path) -> Path:
    """Fetch the crate through cargo, which holds its files against its hash, and that against ours."""
    sources = folder / f"{CRATE}-{CRATE_VERSION}"
    if sources.is_dir():
        return sources
    project, vendored = folder / "cargo", folder / "cargo" / "vendored"
    (project / "src").mkdir(parents=True, exist_ok=True)
    (project / "src" / "lib.rs").touch()
    dependency = f'[dependencies]\n{CRATE} = "={CRATE_VERSION}"\n'
    (project / "Cargo.toml").write_text(f'[package]\nname = "none"\nversion = "0.1.0"\n[workspace]\n{dependency}')
    build.run(["cargo", "vendor", "--quiet", str(vendored)], cwd=project)
    told = json.loads((vendored / CRATE / ".cargo-checksum.json").read_text())["package"]
    if told != CRATE_SHA256:
        raise RuntimeError(f"{CRATE} {CRATE_VERSION} has the hash {told}")
    (vendored / CRATE / "src" / "stm32f103").rename(sources)
    shutil.rmtree(project)
    return sources


def _number(element: ET.Element, tag: str) -> int:
    return int(element.findtext(tag, "0"), 0)


def _read_svd(text: str) -> tuple[dict[str, int], dict[str, dict[str, int]]]:
    blocks = {block.findtext("name", ""): block for block in ET.fromstring(text).iter("peripheral")}
    addresses: dict[str, int] = {}
    fields: dict[str, dict[str, int]] = {}
    for name, block in blocks.items():
        for register in blocks.get(block.get("derivedFrom", ""), block).iter("register"):
            # a register with two meanings stands twice: CCMR1_Input, CCMR1_Output
            key = f"{name}.{re.sub(r'_(In|Out)put$', '', register.findtext('name', ''))}"
            addresses[key] = _number(block, "baseAddress") + _number(register, "addressOffset")
            masks = fields.setdefault(key, {})
            for bits in register.iter("field"):
                masks[bits.findtext("name", "")] = (1 << _number(bits, "bitWidth")) - 1 << _number(bits, "bitOffset")
    # the controller's priorities are a byte for each interrupt, the SVD has them by words
    for irq in range(43):
        byte = fields[f"NVIC.IPR{irq // 4}"][f"IPR_N{irq % 4}"].bit_length() // 8 - 1
        addresses[f"NVIC.IPR[{irq}]"] = addresses[f"NVIC.IPR{irq // 4}"] + byte
    return addresses, fields


def _read_values(sources: Path) -> dict[str, int]:
    values = {}
    for path in sources.rglob("*.rs"):
        for name, body in re.findall(r"^pub enum (\w+) \{(.*?)^\}", path.read_text(), re.MULTILINE | re.DOTALL):
            for variant, value in re.findall(r"^\s+(\w+) = (\d+),", body, re.MULTILINE):
                values[f"{path.relative_to(sources).with_suffix('').as_posix()}.{name}.{variant}"] = int(value)
    return values


def read_maker(folder: Path, sources: Path) -> Maker:
    """What the strangers say."""
    with zipfile.ZipFile(folder / DEBUGGER) as wheel:
        with zipfile.ZipFile(io.BytesIO(wheel.read("pyocd/debug/svd/svd_data.zip"))) as descriptions:
            addresses, fields = _read_svd(descriptions.read("STM32F103xx.svd").decode())
        core = wheel.read("pyocd/coresight/cortex_m.py").decode()
        status = re.search(r"CFSR = (\w+)", wheel.read("pyocd/commands/values.py").decode())
    with zipfile.ZipFile(folder / LOADER) as wheel:
        serial = re.search(
            r"UID_ADDRESS = .*?\"F1\": (\w+)", wheel.read("stm32loader/bootloader.py").decode(), re.DOTALL
        )
    aircr = re.search(r"NVIC_AIRCR = \((\w+)\)", core)
    vtor = re.search(r"VTOR = (\w+)", core)
    key = re.search(r"NVIC_AIRCR_VECTKEY = \((\w+) << (\d+)\)", core)
    request = re.search(r"NVIC_AIRCR_SYSRESETREQ = \(1 << (\d+)\)", core)
    bits = re.search(r"NVIC_PRIO_BITS: u8 = (\d+)", (sources / "mod.rs").read_text())
    assert serial and aircr and vtor and status and key and request and bits
    addresses |= {
        "UID": int(serial[1], 0),
        "SCB.AIRCR": int(aircr[1], 0),
        "SCB.VTOR": int(vtor[1], 0),
        "SCB.CFSR": int(status[1], 0),
    }
    reset = int(key[1], 0) << int(key[2]) | 1 << int(request[1])
    return Maker(addresses, fields, _read_values(sources), reset, int(bits[1]))


def has_cargo() -> bool:
    """Whether cargo can be run."""
    return (
        shutil.which("cargo") is not None
        and subprocess.run(["cargo", "--version"], capture_output=True).returncode == 0
    )
