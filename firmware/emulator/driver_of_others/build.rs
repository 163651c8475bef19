//! Compiles the card's model and its few entries for Rust. The C compiler and `ar` are needed for the host tests anyway.
use std::{env, path::PathBuf, process::Command};

fn run(program: &str, arguments: &[&str]) {
    let status = Command::new(program).args(arguments).status();
    assert!(status.is_ok_and(|status| status.success()), "{program} failed");
}

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap());
    let path = |name: &str| out.join(name).to_str().unwrap().to_owned();
    let models = "../../tests/drivers";
    println!("cargo:rerun-if-changed=entries.c");
    println!("cargo:rerun-if-changed={models}/sd_model.c");
    println!("cargo:rerun-if-changed={models}/sd_model.h");
    let (model, entries) = (path("sd_model.o"), path("entries.o"));
    let include = format!("-I{models}");
    run("cc", &["-O1", "-c", &format!("{models}/sd_model.c"), "-o", &model]);
    run("cc", &["-O1", &include, "-c", "entries.c", "-o", &entries]);
    run("ar", &["rcs", &path("libcard.a"), &model, &entries]);
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rustc-link-lib=static=card");
}
