//! Recordings: a folder with CSV files and `mapping.toml`, on disk or inside the binary.

use super::{Plan, ReplayError};
use std::path::Path;

/// The name of a recording's mapping file.
pub const MAPPING_FILE: &str = "mapping.toml";

/// Recordings inside the binary, so that the demo needs nothing else.
#[derive(rust_embed::RustEmbed)]
#[folder = "../../tests/recordings"]
struct Embedded;

/// Names of the recordings inside the binary.
pub fn embedded() -> Vec<String> {
    let suffix = format!("/{MAPPING_FILE}");
    let mut names: Vec<String> =
        Embedded::iter().filter_map(|path| path.strip_suffix(&suffix).map(str::to_owned)).collect();
    names.sort();
    names
}

/// Reads a recording inside the binary; `mapping` replaces its own.
pub fn read_embedded(name: &str, mapping: Option<&str>) -> Result<Plan, ReplayError> {
    let prefix = format!("{name}/");
    let mut files = Vec::new();
    let mut own = None;
    for path in Embedded::iter() {
        let (Some(file), Some(content)) = (path.strip_prefix(&prefix), Embedded::get(&path)) else {
            continue;
        };
        if file == MAPPING_FILE {
            own = Some(String::from_utf8_lossy(&content.data).into_owned());
        } else {
            files.push((file.to_owned(), content.data.into_owned()));
        }
    }
    let unknown =
        || ReplayError::Mapping(format!("no recording {name:?}; inside are {}", embedded().join(", ")));
    let mapping = mapping.map(str::to_owned).or(own).ok_or_else(unknown)?;
    Plan::read(&mapping, &files)
}

/// Reads the recording in `folder`; `mapping` replaces `mapping.toml` in it.
pub fn read_folder(folder: &Path, mapping: Option<&Path>) -> Result<Plan, ReplayError> {
    let refuse = |path: &Path, error: &std::io::Error| ReplayError::Recording {
        file: path.display().to_string(),
        message: error.to_string(),
    };
    let mapping = mapping.map_or_else(|| folder.join(MAPPING_FILE), Path::to_path_buf);
    let text = std::fs::read_to_string(&mapping).map_err(|error| refuse(&mapping, &error))?;
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|error| refuse(folder, &error))? {
        let path = entry.map_err(|error| refuse(folder, &error))?.path();
        let named = path.file_name().and_then(|name| name.to_str()).map(str::to_owned);
        // Only CSV files are read into memory: a folder may hold photographs of the machine too.
        let is_csv = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
        if let (Some(name), true) = (named, is_csv) {
            let bytes = std::fs::read(&path).map_err(|error| refuse(&path, &error))?;
            files.push((name, bytes));
        }
    }
    Plan::read(&text, &files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn michigan_is_a_cycle_per_experiment_and_layer() {
        let plan = read_embedded("michigan-smart", None).unwrap();
        // Experiments 4, 5 and 16 were stopped in layer 1, experiment 7 in layer 2.
        assert_eq!(plan.cycles.len(), 47);
        let cycle = plan.cycles.iter().find(|cycle| cycle.id.as_str() == "experiment-01-layer-1").unwrap();
        assert_eq!(cycle.operation.as_str(), "layer-1-feed-6");
        assert_eq!(cycle.tool.as_str(), "michigan-unworn");
        assert_eq!(cycle.channels[0].1.len(), 172 + 148);
        assert!(plan.cycles.iter().all(|cycle| !cycle.operation.as_str().ends_with("feed-50")));
        let feed = &plan.registrations.operations["layer-1-feed-6"]["programmed_feed_mm_min"];
        assert!((feed.as_f64().unwrap() - 360.0).abs() < 1e-9);
        assert_eq!(plan.dropped_rows, 0);
        let aborted: Vec<&str> =
            plan.cycles.iter().filter(|cycle| cycle.aborted).map(|cycle| cycle.id.as_str()).collect();
        assert_eq!(aborted, ["experiment-04-layer-1", "experiment-05-layer-1", "experiment-07-layer-2"]);
    }

    #[test]
    fn vicomtech_is_three_rows_of_one_tool_at_one_speed() {
        let plan = read_embedded("vicomtech-turning", None).unwrap();
        assert_eq!(plan.registrations.tools.len(), 13);
        assert_eq!(plan.cycles.len() * 3 + plan.dropped_rows, 2054);
        let used: Vec<&str> = plan
            .registrations
            .mounts
            .iter()
            .filter(|mount| mount.kind == "mounted_used")
            .map(|mount| mount.tool.as_str())
            .collect();
        assert_eq!(used, ["vicomtech-14", "vicomtech-6", "vicomtech-9"]);
        assert!(plan.cycles.iter().all(|cycle| cycle.channels[0].1.len() == 3));
    }

    #[test]
    fn a_folder_is_read_whole_however_endings_are_written() {
        let folder = std::env::temp_dir().join(format!("feedwright-endings-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(MAPPING_FILE), crate::replay::mapping::tests::SMALL).unwrap();
        for name in ["A.CSV", "b.csv", "c.Csv"] {
            std::fs::write(folder.join(name), "p\n1\n2\n").unwrap();
        }
        std::fs::write(folder.join("d.txt"), [0xff]).unwrap();
        let plan = read_folder(&folder, None);
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(plan.unwrap().cycles.len(), 3);
    }

    #[test]
    fn an_unknown_recording_names_those_inside() {
        let said = read_embedded("mars", None).unwrap_err().to_string();
        assert!(said.contains("michigan-smart, vicomtech-turning"), "{said}");
    }
}
