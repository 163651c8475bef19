//! The card's model under a driver that others wrote (crate embedded-sdmmc): does a stranger's reading of the
//! specification understand what the model answers, and accept its sums, and does the model accept the stranger's?
//!
//! Prints a line for each kind of card, with and without disturbed wires; exit code 0, or 1 with what was wrong.
use embedded_hal::{delay::DelayNs, spi};
use embedded_sdmmc::sdcard::spi::{AcquireOpts, Error, SdCard};
use embedded_sdmmc::{Block, BlockDevice, BlockIdx};
use std::{convert::Infallible, process::ExitCode};

const KINDS: [&str; 3] = ["version 1", "version 2", "high capacity"]; // sd_model_kind_t
const SECTORS: u32 = 65_536;
const BLOCKS: u32 = 400;
const TRIES: u32 = 20;

extern "C" {
    fn card_open(kind: i32, sectors: u32, flip_every: u32);
    fn card_select(is_selected: bool);
    fn card_speed_up();
    fn card_exchange(out: u8) -> u8;
    fn card_wait_ns(duration_ns: u32);
    fn card_flaw() -> i32;
    fn card_flips() -> u32;
    fn card_wrong_sums() -> u32;
}

/// The chip select stays low once it is: the driver makes many transactions of one command.
struct Wires;

impl spi::ErrorType for Wires {
    type Error = Infallible;
}

fn exchange(out: u8) -> u8 {
    unsafe { card_exchange(out) }
}

fn send(out: u8) {
    exchange(out);
}

impl spi::SpiDevice for Wires {
    fn transaction(&mut self, operations: &mut [spi::Operation<'_, u8>]) -> Result<(), Infallible> {
        for operation in operations {
            match operation {
                spi::Operation::Read(bytes) => bytes.iter_mut().for_each(|byte| *byte = exchange(0xFF)),
                spi::Operation::Write(bytes) => bytes.iter().for_each(|byte| send(*byte)),
                spi::Operation::TransferInPlace(bytes) => bytes.iter_mut().for_each(|byte| *byte = exchange(*byte)),
                spi::Operation::Transfer(into, from) => {
                    into.iter_mut().zip(from.iter()).for_each(|(byte, out)| *byte = exchange(*out))
                }
                spi::Operation::DelayNs(duration) => unsafe { card_wait_ns(*duration) },
            }
        }
        Ok(())
    }
}

struct Clock;

impl DelayNs for Clock {
    fn delay_ns(&mut self, duration: u32) {
        unsafe { card_wait_ns(duration) }
    }
}

fn content(number: u32) -> Block {
    let mut block = Block::new();
    for (i, byte) in block.contents.iter_mut().enumerate() {
        *byte = (number * 131 + i as u32 * 7 + (i as u32 >> 5)) as u8;
    }
    block
}

/// What fails on disturbed wires is done again, with a new start of the card.
fn with_tries<T>(
    card: &SdCard<Wires, Clock>,
    action: impl Fn() -> Result<T, Error>,
) -> Result<T, String> {
    let mut said = String::new();
    for _ in 0..TRIES {
        match action() {
            Ok(value) => return Ok(value),
            Err(error) => said = format!("{error:?}"),
        }
        unsafe {
            card_select(false);
            (0..20).for_each(|_| send(0xFF));
            card_select(true);
            (0..600).for_each(|_| send(0xFF));
        }
        card.mark_card_uninit();
    }
    Err(said)
}

fn drive(kind: i32, flip_every: u32, use_crc: bool) -> Result<String, String> {
    unsafe {
        card_open(kind, SECTORS, flip_every);
        (0..10).for_each(|_| send(0xFF)); // 74 clocks before the first command
        card_select(true);
    }
    let card = SdCard::new_with_options(Wires, Clock, AcquireOpts { use_crc, acquire_retries: 50 });
    let count = with_tries(&card, || card.num_blocks())?.0;
    if count != SECTORS {
        return Err(format!("{count} sectors of {SECTORS}"));
    }
    unsafe { card_speed_up() };
    let blocks: Vec<Block> = (0..BLOCKS).map(content).collect();
    for (i, four) in blocks.chunks(4).enumerate() {
        with_tries(&card, || card.write(four, BlockIdx(1000 + 4 * i as u32)))?;
        send(0xFF); // N_BR: a card may show itself busy a byte after the stop token; this driver looks at once
    }
    with_tries(&card, || card.write(&blocks[..1], BlockIdx(SECTORS - 1)))?;
    for (at, wanted) in (1000..).zip(&blocks).chain([(SECTORS - 1, &blocks[0])]) {
        let got = with_tries(&card, || {
            let mut got = [Block::new()];
            card.read(&mut got, BlockIdx(at)).map(|()| got)
        })?;
        if got[0].contents != wanted.contents {
            return Err(format!("sector {at} is not as it was written"));
        }
    }
    let (flaw, flips, wrong_sums) = unsafe { (card_flaw(), card_flips(), card_wrong_sums()) };
    if flaw != 0 || (flip_every == 0 && wrong_sums != 0) {
        return Err(format!("the model complains: flaw {flaw}, {wrong_sums} wrong sums"));
    }
    Ok(format!("{} sectors as written, {flips} bits flipped, {wrong_sums} refused by the card", BLOCKS + 1))
}

fn main() -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for (kind, name) in KINDS.iter().enumerate() {
        for (flip_every, use_crc) in [(0, true), (0, false), (20_000, true), (5_000, true)] {
            let how = format!("{name}, sums {}, a flip in {flip_every}", if use_crc { "on" } else { "off" });
            match drive(kind as i32, flip_every, use_crc) {
                Ok(said) => println!("{how}: {said}"),
                Err(said) => {
                    println!("{how}: WRONG: {said}");
                    code = ExitCode::FAILURE;
                }
            }
        }
    }
    code
}
