//! The files of the pages: found by name, compressed once.

use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::collections::HashMap;
use std::io::Write;
use std::sync::{LazyLock, Mutex, PoisonError};

/// Whether files are read at every request, as `rust-embed` does in debug builds.
pub(super) const FROM_DISK: bool = cfg!(debug_assertions);

#[derive(rust_embed::RustEmbed)]
#[folder = "src/ui/web/"]
struct Web;

/// A file as it is answered.
#[derive(Debug, Clone)]
pub(super) struct File {
    pub(super) kind: &'static str,
    pub(super) bytes: Bytes,
    /// Where that is smaller.
    pub(super) gzip: Option<Bytes>,
    pub(super) etag: String,
}

impl File {
    pub(super) fn of(name: &str, bytes: Vec<u8>) -> Self {
        let kind = kind_of(name);
        let etag = format!("\"{}\"", &blake3::hash(&bytes).to_hex()[..16]);
        let gzip = if kind.ends_with("utf-8") { compressed(&etag, &bytes) } else { None };
        Self { kind, bytes: bytes.into(), gzip, etag }
    }
}

fn kind_of(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml; charset=utf-8",
        Some("woff2") => "font/woff2",
        _ => "text/plain; charset=utf-8",
    }
}

/// Compressed files by tag that are remembered: a file that is read at every request is not compressed at every request.
const REMEMBERED: usize = 100;

fn compressed(etag: &str, bytes: &[u8]) -> Option<Bytes> {
    static KNOWN: LazyLock<Mutex<HashMap<String, Option<Bytes>>>> = LazyLock::new(Mutex::default);
    let known = || KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(found) = known().get(etag) {
        return found.clone();
    }
    let made = gzip(bytes).filter(|zip| zip.len() < bytes.len()).map(Bytes::from);
    let mut known = known();
    if known.len() >= REMEMBERED {
        known.clear();
    }
    known.insert(etag.to_owned(), made.clone());
    made
}

fn gzip(bytes: &[u8]) -> Option<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).ok()?;
    encoder.finish().ok()
}

static EMBEDDED: LazyLock<HashMap<String, File>> = LazyLock::new(|| {
    let named = Web::iter().filter_map(|name| Some((name.to_string(), read(&name)?)));
    named.collect()
});

fn read(name: &str) -> Option<File> {
    Web::get(name).map(|found| File::of(name, found.data.into_owned()))
}

/// The file of that name.
pub(super) fn find(name: &str) -> Option<File> {
    if FROM_DISK { read(name) } else { EMBEDDED.get(name).cloned() }
}

/// Every module that a module needs, itself first: a browser that is told of them all fetches them at once, instead of
/// finding one behind the other.
pub(super) fn modules(name: &str) -> Vec<String> {
    let mut found = vec![name.to_owned()];
    let mut next = 0;
    while let Some(name) = found.get(next).cloned() {
        next += 1;
        let Some(file) = find(&name) else { continue };
        for wanted in imports(&name, &String::from_utf8_lossy(&file.bytes)) {
            if !found.contains(&wanted) {
                found.push(wanted);
            }
        }
    }
    found
}

/// The modules that the text of a module imports, as names of files.
fn imports(name: &str, text: &str) -> Vec<String> {
    let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
    let lines = text.lines().filter(|line| line.starts_with("import ") || line.starts_with("export "));
    let paths = lines.filter_map(|line| line.rsplit_once("from \"")?.1.split('"').next());
    paths
        .map(|path| {
            let mut parts: Vec<&str> = folder.split('/').collect();
            for part in path.split('/') {
                match part {
                    "." => {}
                    ".." => drop(parts.pop()),
                    part => parts.push(part),
                }
            }
            parts.join("/")
        })
        .collect()
}

/// Names all files together: a browser may keep what it has of this version for ever.
pub(super) fn version() -> &'static str {
    static VERSION: LazyLock<String> = LazyLock::new(|| {
        if FROM_DISK {
            return "dev".to_owned();
        }
        let mut tags: Vec<String> =
            EMBEDDED.iter().map(|(name, file)| format!("{name} {}", file.etag)).collect();
        tags.sort();
        blake3::hash(tags.join("\n").as_bytes()).to_hex()[..12].to_owned()
    });
    &VERSION
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_module_that_is_imported_is_there() {
        let mut seen = 0;
        for name in Web::iter().filter(|name| name.ends_with(".js") && !name.starts_with("vendor/")) {
            let text = String::from_utf8(Web::get(&name).unwrap().data.into_owned()).unwrap();
            for wanted in imports(&name, &text) {
                assert!(Web::get(&wanted).is_some(), "{name} imports {wanted}");
                seen += 1;
            }
        }
        assert!(seen > 20, "only {seen} imports were found");
    }

    #[test]
    fn a_page_is_told_of_what_its_modules_import() {
        let modules = modules("js/pages/cycle.js");
        for wanted in ["js/pages/cycle.js", "js/words/de.js", "vendor/uplot/uPlot.esm.js"] {
            assert!(modules.iter().any(|name| name == wanted), "{wanted} is not in {modules:?}");
        }
        assert!(!modules.iter().any(|name| name.starts_with("js/pages/") && name != "js/pages/cycle.js"));
    }

    #[test]
    fn a_file_that_shrinks_is_kept_compressed() {
        let file = File::of("a.js", b"const a = 1;\n".repeat(100));
        assert!(file.gzip.as_ref().unwrap().len() < file.bytes.len() / 2);
        assert!(File::of("a.woff2", vec![0; 1000]).gzip.is_none());
        assert!(File::of("a.js", vec![b'x']).gzip.is_none());
    }
}
