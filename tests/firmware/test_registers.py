"""Every register, bit and value of the port's header agrees with what the maker and others say of the controller.

Interrupts, DMA channels, pins and memory are compared in test_build.py.
"""

import contextlib
import fcntl
import functools
import operator
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
PORT = FIRMWARE / "port" / "stm32f103"
HEADER = (PORT / "stm32f103.h").read_text()
FETCHED = FIRMWARE.parent / "build" / "registers"
sys.path[:0] = [str(FIRMWARE), str(Path(__file__).parent)]
import register_map  # noqa: E402
from register_map import CHANNELS, Header, Maker  # noqa: E402

import build  # noqa: E402

# ---- what is to be compared with what ----

INSTANCES = {"DMA": ["DMA1"], "SPI": ["SPI1", "SPI2"], "USART": ["USART1", "USART2"], "TIM": ["TIM2"]}
COMPARED_ELSEWHERE = re.compile(r"DMA_(SPI|USART)\d_[RT]X")
FIELD_NAMES = {"DMA_CCR_PRIORITY": "PL", "IWDG_KR": "KEY", "IWDG_PR": "PR"}  # where the header has another word
SETS = {  # constants of more than one field, or of one field in registers of several names
    "USART_SR_ERRORS": [(f"USART{n}.SR", ["PE", "FE", "NE", "ORE"]) for n in (1, 2)],
    "EXTI_LINE0": [("EXTI.IMR", ["MR0"]), ("EXTI.RTSR", ["TR0"]), ("EXTI.PR", ["PR0"])],
}
for _n in CHANNELS:
    _flags = [f"{flag}{_n}" for flag in ("GIF", "TCIF", "HTIF", "TEIF")]
    SETS[f"DMA_FLAGS({_n})"] = [("DMA1.ISR", _flags), ("DMA1.IFCR", [f"C{flag}" for flag in _flags])]
    SETS[f"DMA_TC({_n})"] = [("DMA1.ISR", [f"TCIF{_n}"])]
    SETS[f"DMA_TE({_n})"] = [("DMA1.ISR", [f"TEIF{_n}"])]
SETS |= {
    f"GPIO_{use}": [("GPIOA.CRL", ["MODE0", "CNF0"])]
    for use in ("FLOATING", "PULLED", "OUTPUT_2MHZ", "OUTPUT_50MHZ", "ALTERNATE_2MHZ", "ALTERNATE_50MHZ")
}
# A field's value is written as the crate names it: file.ENUM.Variant; two fields side by side as two of them.
IN, SLOW, FAST = (f"gpioa/crl.MODE.{name}" for name in ("Input", "Output2", "Output50"))
# the crate names a configuration as it is for outputs; of an input, 1 is floating and 2 is pulled
FLOATING, PULLED, PUSH_PULL, ALTERNATE = (
    f"gpioa/crl.CONFIG.{name}" for name in ("OpenDrain", "AltPushPull", "PushPull", "AltPushPull")
)
VALUES = {
    "RCC_CFGR_SW_PLL": ["rcc/cfgr.SW.Pll"],
    "RCC_CFGR_SWS_PLL": ["rcc/cfgr.SWSR.Pll"],
    "RCC_CFGR_PPRE1_DIV2": ["rcc/cfgr.PPRE1.Div2"],
    "RCC_CFGR_PLLSRC_HSE": ["rcc/cfgr.PLLSRC.HseDivPrediv"],
    "FLASH_ACR_LATENCY_2": ["flash/acr.LATENCY.Ws2"],
    "AFIO_EXTICR1_EXTI0_PB": ["afio/exticr1.EXTI0.Pb"],
    "DMA_CCR_DIR_FROM_MEMORY": ["dma1/ch/cr.DIR.FromMemory"],
    "TIM_CCMR1_IC2F_8": ["tim2/ccmr1_input.ICFILTER.FckIntN8"],
    "IWDG_KR_START": ["iwdg/kr.KEY.Start"],
    "IWDG_KR_UNLOCK": ["iwdg/kr.KEY.Unlock"],
    "IWDG_KR_FEED": ["iwdg/kr.KEY.Feed"],
    "IWDG_PR_DIV64": ["iwdg/pr.PR.DivideBy64"],
    "GPIO_FLOATING": [IN, FLOATING],
    "GPIO_PULLED": [IN, PULLED],
    "GPIO_OUTPUT_2MHZ": [SLOW, PUSH_PULL],
    "GPIO_OUTPUT_50MHZ": [FAST, PUSH_PULL],
    "GPIO_ALTERNATE_2MHZ": [SLOW, ALTERNATE],
    "GPIO_ALTERNATE_50MHZ": [FAST, ALTERNATE],
}
VALUES |= {f"RCC_CFGR_PLLMUL({n})": [f"rcc/cfgr.PLLMUL.Mul{n}"] for n in range(2, 17)}
VALUES |= {f"SPI_CR1_BR({n})": [f"spi1/cr1.BR.Div{2 << n}"] for n in range(8)}
VALUES |= {
    f"DMA_CCR_PRIORITY({n})": [f"dma1/ch/cr.PL.{name}"] for n, name in enumerate(("Low", "Medium", "High", "VeryHigh"))
}
MANUAL_ONLY = {"PWR_CR_PLS_2V9": 7}  # in volts, this one stands in no description but the manual (RM0008, 5.4.1)


def registers_of(block: str, name: str) -> list[str]:
    """Registers that a constant named for `name` of `block` is used with."""
    names = [f"{name}{n}" for n in CHANNELS] if block == "DMA" else [name]
    return [f"{instance}.{one}" for instance in INSTANCES.get(block, [block]) for one in names]


def field_of(constant: str, rest: str, known: dict[str, int]) -> str | None:
    """The field a constant belongs to: the longest name that its own begins with."""
    for prefix, name in FIELD_NAMES.items():
        if constant.startswith(prefix):
            return name
    fitting = [name for name in known if f"{rest}_".startswith(f"{name}_")]
    return max(fitting, key=len) if fitting else None


def places_of(constant: str, maker: Maker) -> tuple[list[int], bool]:
    """Masks of the bits a constant stands for, one for each register, and whether it must fill them."""
    if constant in SETS:
        masks = [sum(maker.fields[register][name] for name in names) for register, names in SETS[constant]]
        return masks, constant not in VALUES
    block, name, rest = constant.partition("(")[0].split("_", 2)
    masks, is_whole = [], False
    for register in registers_of(block, name):
        known = maker.fields.get(register, {})
        bits = field_of(constant, rest, known)
        masks.append(known.get(bits or "", 0))
        is_whole = rest in (bits, f"{bits}_MASK")
    return masks, is_whole and constant not in VALUES


def value_within(mask: int) -> int:
    """Factor that moves a field's value to the place of the mask."""
    return mask & -mask


def expected_value(constant: str, mask: int, maker: Maker) -> int | None:
    """What the maker would write for a value of a field."""
    if constant in MANUAL_ONLY:
        return MANUAL_ONLY[constant] * value_within(mask)
    values = [maker.values.get(name) for name in VALUES.get(constant, [])]
    if not values or None in values:
        return None
    return sum(value << 2 * n for n, value in enumerate(values)) * value_within(mask)


def differences(header: Header, maker: Maker) -> list[str]:
    """Every register, constant and pin for which header and maker differ or the maker knows nothing."""
    wrong = [name for name, address in header.registers.items() if maker.registers.get(name) != address]
    for constant, value in header.constants.items():
        if COMPARED_ELSEWHERE.fullmatch(constant):
            continue
        if constant == "SCB_AIRCR_SYSRESET":
            wrong += [constant] * (value != maker.reset_request)
            continue
        masks, is_whole = places_of(constant, maker)
        expected = [mask if is_whole else expected_value(constant, mask, maker) for mask in masks]
        wrong += [constant] * (set(expected) != {value} or 0 in masks or any(value & ~mask for mask in masks))
    for pin, bits in header.pins.items():
        half = maker.fields["GPIOA.CRL" if pin < 8 else "GPIOA.CRH"]
        mask = half[f"MODE{pin}"] | half[f"CNF{pin}"]
        wrong += [f"pin {pin}"] * (bits != (mask if pin < 8 else mask << 32))
    return wrong


# ---- fixtures ----


@pytest.fixture(scope="module")
def compiler():
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        pytest.skip("needs system package gcc")
    return found


@pytest.fixture(scope="module")
def header(compiler, tmp_path_factory) -> Header:
    return register_map.read_header(HEADER, compiler, tmp_path_factory.mktemp("header"))


@pytest.fixture(scope="module")
def maker() -> Maker:
    with contextlib.suppress(build.MissingError):
        build.find_tools(("cargo",))
    if not register_map.has_cargo():
        pytest.skip("needs system package cargo, to fetch what others say of the registers")
    FETCHED.mkdir(parents=True, exist_ok=True)
    with (FETCHED.parent / "registers.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            register_map.fetch_wheels(FETCHED)
            sources = register_map.fetch_crate(FETCHED)
        except RuntimeError as error:
            pytest.skip(f"needs system package cargo, and the descriptions of the registers: {error}")
    return register_map.read_maker(FETCHED, sources)


# ---- the comparison ----


def test_every_register_bit_and_value_agrees(header, maker):
    assert len(header.registers) > 150
    assert len(header.constants) > 120
    assert differences(header, maker) == []


def test_no_macro_of_the_header_is_left_out(header):
    told = {re.split(r"[.(]", name)[0] for name in (*header.registers, *header.constants)}
    told |= {"FLASH_ACR", "SCB_AIRCR", "SCB_VTOR", "SCB_CFSR", "NVIC_ISER", "NVIC_IPR", "UNIQUE_ID"}
    assert set(re.findall(r"^#define (\w+)(?:\(\w+\))? \S", HEADER, re.MULTILINE)) <= told


def test_no_source_of_the_port_has_an_address_of_its_own():
    for path in PORT.glob("*.c"):
        assert not re.findall(r"0x[4Ee][0-9A-Fa-f]{7}\b", path.read_text()), path.name


def test_priorities_are_shifted_to_the_bits_the_controller_has(maker):
    shifts = [
        int(shift)
        for path in (*PORT.glob("*.c"), PORT / "stm32f103.h")
        for shift in re.findall(r"(?:priority|PRIORITY_\w+) << (\d+)", path.read_text())
    ]
    assert len(shifts) == 2
    assert set(shifts) == {8 - maker.priority_bits}


def test_pins_are_where_the_port_writes_a_pin_number_as_a_bit(maker):
    for register, name in (("IDR", "IDR"), ("BSRR", "BS"), ("BRR", "BR")):
        for port in "ABC":
            assert all(maker.fields[f"GPIO{port}.{register}"][f"{name}{pin}"] == 1 << pin for pin in range(16))


def test_reset_cause_of_the_format_is_the_upper_byte_of_the_register(maker):
    flags = [mask for name, mask in maker.fields["RCC.CSR"].items() if name.endswith("RSTF")]
    assert sum(flags) == 0xFC << 24
    assert "board.reset_cause = (uint8_t)(RCC->CSR >> 24);" in (PORT / "board.c").read_text()


# ---- the emulated chip ----

EMULATOR = FIRMWARE / "emulator"
BLOCK = re.compile(r"\{(\w+), (\w+), (\d+), \w+, \"(\w+)\", REGISTERS\((\w+)\)\}")


def chip_differences(registers_text: str, rules_text: str, maker: Maker) -> list[str]:
    """Every block, register and bit that the emulated chip's rules have otherwise than the maker."""
    offsets = {
        name: int(value, 16) for name, value in re.findall(r"^    (\w+) = (0x\w{5}),?$", registers_text, re.MULTILINE)
    }
    bits = {
        name: [int(value, 16) for value in values.split(", ")]
        for name, values in re.findall(r"^static const uint32_t (\w+_BITS)\[\] = \{(.*)\};", rules_text, re.MULTILINE)
    }
    names = {address: name for name, address in maker.registers.items()}
    wrong = []
    for block, enable, bit, text, table in BLOCK.findall(rules_text):
        base = 0x40000000 + offsets[block]
        for number, mask in enumerate(bits[table]):
            name = names.get(base + 4 * number, "")
            is_there = name.startswith(f"{text}.")
            known = functools.reduce(operator.or_, maker.fields[name].values(), 0) if is_there else 0
            wrong += [name or f"{block} {number}"] * (mask not in (0, known) or (mask != 0 and not is_there))
        if enable != "NONE":
            fields = maker.fields[f"RCC.{enable.removeprefix('R_')}"]
            key = f"{'IOP' + text[-1] if text.startswith('GPIO') else text}EN"
            wrong += [key] * (fields.get(key, 0) != 1 << int(bit))
    return wrong


def chip_texts() -> tuple[str, str]:
    return (EMULATOR / "chip_registers.h").read_text(), (EMULATOR / "rules.c").read_text()


def test_emulated_chip_has_the_registers_bits_and_clocks_that_the_maker_has(maker):
    registers, rules = chip_texts()
    assert len(BLOCK.findall(rules)) == 16
    assert chip_differences(registers, rules, maker) == []


@pytest.mark.parametrize(
    ("right", "wrong", "first"),
    [
        ("PWR_BITS[] = {0x1FF,", "PWR_BITS[] = {0x3FF,", "PWR.CR"),
        ("{SPI2, R_APB1ENR, 14,", "{SPI2, R_APB1ENR, 15,", "SPI2EN"),
        ("IWDG_BITS[] = {0xFFFF, ", "IWDG_BITS[] = {", "IWDG.KR"),
    ],
)
def test_wrong_line_of_the_emulated_chip_is_found(maker, right, wrong, first):
    registers, rules = chip_texts()
    assert right in rules
    assert chip_differences(registers, rules.replace(right, wrong), maker)[0] == first


# ---- the comparison can fail ----


def test_every_single_wrong_address_or_value_is_found(header, maker):
    for name, address in header.registers.items():
        wrong = replace(header, registers=header.registers | {name: address + 4})
        assert differences(wrong, maker) == [name]
    for name, value in header.constants.items():
        if not COMPARED_ELSEWHERE.fullmatch(name):
            for other in (value << 1, value >> 1, value | 1 << 31, 0):
                wrong = replace(header, constants=header.constants | {name: other})
                assert differences(wrong, maker) == [name] * (other != value), f"{name} {other:x}"
    for pin, bits in header.pins.items():
        assert differences(replace(header, pins={pin: bits << 4}), maker) == [f"pin {pin}"]


@pytest.mark.parametrize(
    ("right", "wrong", "first"),
    [
        ("reg_t reserved, DR[10];", "reg_t DR[10];", "BKP.DR1"),
        ("ARR, reserved, CCR[4];", "ARR, CCR[4];", "TIM2.CCR1"),
        ("CMAR, reserved;", "CMAR;", "DMA1.CCR2"),
        ("CRL, CRH, IDR, ODR, BSRR, BRR", "CRL, CRH, ODR, IDR, BSRR, BRR", "GPIOA.ODR"),
        ("0x40004400u", "0x40004800u", "USART2.SR"),
        ("#define RCC_CR_PLLON (1u << 24)", "#define RCC_CR_PLLON (1u << 25)", "RCC_CR_PLLON"),
        ("(((n)-2u) << 18)", "(((n)-1u) << 18)", "RCC_CFGR_PLLMUL(2)"),
        ("#define TIM_SR_CC1IF", "#define TIM_SR_CC5IF", "TIM_SR_CC5IF"),
        ("4 * (pin % 8)", "4 * (pin % 7)", "pin 7"),
        ("CNDTR, CPAR, CMAR", "CNDTR, CMAR, CPAR", "DMA1.CMAR1"),
    ],
)
def test_wrong_line_of_the_header_is_found(compiler, maker, tmp_path, right, wrong, first):
    assert right in HEADER
    told = register_map.read_header(HEADER.replace(right, wrong), compiler, tmp_path)
    assert differences(told, maker)[0] == first


def test_description_with_other_bytes_is_not_taken(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(register_map.build, "download", lambda *words: asked.append(words[0]))
    (tmp_path / register_map.DEBUGGER).write_text("not what was asked for")
    register_map.fetch_wheels(tmp_path)
    assert asked == ["pyocd==0.46.0", "stm32loader==0.7.1"]
