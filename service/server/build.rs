//! How the binary is linked.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=often.ld");
    let variable = |name: &str| std::env::var(name).unwrap_or_default();
    if variable("CARGO_CFG_TARGET_OS") != "linux" || variable("CARGO_CFG_TARGET_ENV") != "gnu" {
        return;
    }
    // Whoever chooses a linker that cannot do this has the same program, of which more stays resident.
    let chosen = variable("CARGO_ENCODED_RUSTFLAGS") + &variable("RUSTC_LINKER");
    if OTHER_LINKERS.iter().any(|linker| chosen.contains(linker)) {
        return;
    }
    // A megabyte of relocations, which stays resident after the start, packed into some kilobytes. Debian has read these
    // since version 12 (glibc 2.36).
    // llvm-bolt does not know them, and needs the linker's own beside (deploy/release/bolted).
    println!("cargo::rerun-if-env-changed={KEEP_RELOCATIONS}");
    if variable(KEEP_RELOCATIONS).is_empty() {
        println!("cargo::rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    } else {
        println!("cargo::rustc-link-arg-bins=-Wl,-z,nopack-relative-relocs");
        println!("cargo::rustc-link-arg-bins=-Wl,--emit-relocs");
    }
    // The linker holds each function's name against each line of the script: minutes where nothing is optimised, and so nothing is
    // left out or put together.
    if variable("OPT_LEVEL") == "0" {
        return;
    }
    // A copy: two checkouts may build into one folder, and the one that this was run for may be gone.
    let script = std::path::Path::new(&variable("OUT_DIR")).join("often.ld");
    std::fs::copy("often.ld", &script)
        .expect("often.ld is there, and can be copied to the output of this script");
    // Not by `-Wl`, which would divide a folder's name at its commas.
    println!("cargo::rustc-link-arg-bins=-T{}", script.display());
}

/// Whether the program is linked so that its code can be moved afterwards.
const KEEP_RELOCATIONS: &str = "FEEDWRIGHT_KEEP_RELOCATIONS";

/// Linkers other than LLVM's, which Rust brings, and GNU's. They do not read the script, and mold 1.10 packs relocations
/// without saying so to glibc, which then starts nothing.
const OTHER_LINKERS: [&str; 3] = ["mold", "wild", "gold"];
