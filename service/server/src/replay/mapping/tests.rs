//! What a mapping file may not say.

use super::*;

pub(crate) const SMALL: &str = r#"
name = "small"
files = "{file}.csv"

[time]
period = "100 ms"
start = "2020-01-01T00:00:00Z"

[cut]
rows = 2

[cycle]
id = "{file}-{index:03}"
machine = "m"
tool = "t"
operation = "o"

[channels.spindle_power_watts]
column = "p"
unit = "kW"
"#;

fn refusal(text: &str) -> String {
    Mapping::parse(text).unwrap_err().to_string()
}

#[test]
fn the_smallest_mapping_is_accepted() {
    let mapping = Mapping::parse(SMALL).unwrap();
    assert_eq!(mapping.columns().into_iter().collect::<Vec<_>>(), ["p"]);
    assert!((mapping.channels["spindle_power_watts"].value(0.178) - 178.0).abs() < 1e-9);
}

#[test]
fn unknown_keys_are_refused_by_name() {
    for (from, to) in [
        ("name = \"small\"", "name = \"small\"\nnmae = 1"),
        ("rows = 2", "rows = 2\nrow = 3"),
        ("column = \"p\"", "column = \"p\"\nfactor = 60"),
        ("tool = \"t\"", "tool = \"t\"\nspeed = 3"),
    ] {
        let said = refusal(&SMALL.replacen(from, to, 1));
        assert!(said.contains("unknown field"), "{said}");
    }
}

#[test]
fn a_channel_must_name_a_unit_of_its_kind() {
    assert!(refusal(&SMALL.replace("unit = \"kW\"", "")).contains("unit"));
    assert!(refusal(&SMALL.replace("\"kW\"", "\"mm/s\"")).contains("needed is a Power"));
    assert!(refusal(&SMALL.replace("\"kW\"", "\"counts\"")).contains("unknown unit"));
    assert!(refusal(&SMALL.replace("spindle_power_watts", "power")).contains("no such channel"));
    assert!(refusal(&SMALL.replace("\"kW\"", "\"kW\"\nscale = 0.0")).contains("scale"));
}

#[test]
fn time_must_be_said_once() {
    for wrong in [
        SMALL.replace("period = \"100 ms\"", ""),
        SMALL.replace("\"100 ms\"", "\"100\""),
        SMALL.replace("\"100 ms\"", "\"0 ms\""),
        SMALL.replace("\"100 ms\"", "\"1e300 h\""),
        SMALL.replace("\"100 ms\"", "\"100 ms\"\nbetween_files = \"1e300 h\""),
        SMALL.replace("start = \"2020-01-01T00:00:00Z\"", ""),
        SMALL.replace("start = \"2020-01-01T00:00:00Z\"", "start = \"yesterday\""),
        SMALL.replace("period = \"100 ms\"", "column = \"t\"\nunit = \"rfc3339\""),
        SMALL.replace("period = \"100 ms\"", "column = \"t\"\nunit = \"W\""),
        SMALL.replace("period = \"100 ms\"", "period = \"100 ms\"\ncolumn = \"t\""),
    ] {
        assert!(refusal(&wrong).contains("mapping"), "{wrong}");
    }
}

#[test]
fn a_cut_must_say_where() {
    assert!(refusal(&SMALL.replace("rows = 2", "")).contains("needs label"));
    assert!(refusal(&SMALL.replace("rows = 2", "rows = 0")).contains("at least 1"));
    assert!(
        refusal(&SMALL.replace("rows = 2", "change = [{ column = \"p\" }]\nshort = \"drop\""))
            .contains("short")
    );
}
