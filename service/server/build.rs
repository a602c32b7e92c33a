//! How the binary is linked.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=seldom.ld");
    let target = |name: &str| std::env::var(format!("CARGO_CFG_TARGET_{name}")).unwrap_or_default();
    let folder = std::env::var("CARGO_MANIFEST_DIR").unwrap_or_default();
    if target("OS") == "linux" && target("ENV") == "gnu" {
        // A megabyte of relocations, which stays resident after the start, packed into some kilobytes. Debian has read
        // these since version 12 (glibc 2.36).
        println!("cargo::rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
        // Not by `-Wl`, which would divide a folder's name at its commas.
        println!("cargo::rustc-link-arg-bins=-T{folder}/seldom.ld");
    }
}
