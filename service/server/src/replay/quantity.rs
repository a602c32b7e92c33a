//! Units that a mapping may name, and what they are in the unit of the API.
//!
//! A recording without a unit is refused: a guessed factor of 60 or 1000 would pass every later check.

use feedwright_core::cycle::Channel;
use serde::Deserialize;

/// What kind of quantity a unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimension {
    /// Told in mm.
    Length,
    /// Told in mm/min.
    Feed,
    /// Told in %.
    Share,
    /// Told in N.
    Force,
    /// Told in N·m.
    Torque,
    /// Told in W.
    Power,
    /// Told in rpm.
    Speed,
    /// Told in A.
    Current,
    /// Told in ms.
    Time,
}

/// A unit by its name, with the factor into the unit of the API.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub struct Unit {
    /// What it measures.
    pub dimension: Dimension,
    factor: f64,
}

/// Names are those of the field; a second spelling only where keyboards lack the sign.
const UNITS: &[(&str, Dimension, f64)] = &[
    ("mm", Dimension::Length, 1.0),
    ("µm", Dimension::Length, 1e-3),
    ("um", Dimension::Length, 1e-3),
    ("cm", Dimension::Length, 10.0),
    ("m", Dimension::Length, 1000.0),
    ("in", Dimension::Length, 25.4),
    ("mm/min", Dimension::Feed, 1.0),
    ("mm/s", Dimension::Feed, 60.0),
    ("m/min", Dimension::Feed, 1000.0),
    ("in/min", Dimension::Feed, 25.4),
    ("%", Dimension::Share, 1.0),
    ("ratio", Dimension::Share, 100.0),
    ("N", Dimension::Force, 1.0),
    ("daN", Dimension::Force, 10.0),
    ("kN", Dimension::Force, 1000.0),
    ("N·m", Dimension::Torque, 1.0),
    ("Nm", Dimension::Torque, 1.0),
    ("mN·m", Dimension::Torque, 1e-3),
    ("kN·m", Dimension::Torque, 1000.0),
    ("W", Dimension::Power, 1.0),
    ("kW", Dimension::Power, 1000.0),
    ("rpm", Dimension::Speed, 1.0),
    ("rev/s", Dimension::Speed, 60.0),
    ("rad/s", Dimension::Speed, 60.0 / std::f64::consts::TAU),
    ("A", Dimension::Current, 1.0),
    ("mA", Dimension::Current, 1e-3),
    ("µs", Dimension::Time, 1e-3),
    ("us", Dimension::Time, 1e-3),
    ("ms", Dimension::Time, 1.0),
    ("s", Dimension::Time, 1000.0),
    ("min", Dimension::Time, 60_000.0),
    ("h", Dimension::Time, 3_600_000.0),
];

impl Unit {
    /// The unit of that name.
    pub fn parse(name: &str) -> Result<Self, String> {
        UNITS
            .iter()
            .find(|(known, _, _)| *known == name)
            .map(|&(_, dimension, factor)| Self { dimension, factor })
            .ok_or_else(|| {
                let known: Vec<&str> = UNITS.iter().map(|(name, _, _)| *name).collect();
                format!("unknown unit {name:?}; known are {}", known.join(", "))
            })
    }

    /// `value` in the unit of the API.
    pub fn convert(self, value: f64) -> f64 {
        value * self.factor
    }
}

impl TryFrom<String> for Unit {
    type Error = String;
    fn try_from(name: String) -> Result<Self, String> {
        Self::parse(&name)
    }
}

/// What a channel measures; its name ends in the unit of the API.
pub fn dimension_of(channel: Channel) -> Dimension {
    use Channel as C;
    match channel {
        C::DepthMm => Dimension::Length,
        C::FeedProgrammedMmMin | C::FeedActualMmMin => Dimension::Feed,
        C::OverridePercent | C::OperatorOverridePercent | C::FeedDriveLoadPercent | C::SpindleLoadPercent => {
            Dimension::Share
        }
        C::SpindleSpeedRpm => Dimension::Speed,
        C::ThrustNewtons => Dimension::Force,
        C::TorqueNewtonMetres | C::FeedDriveTorqueNewtonMetres | C::SpindleTorqueNewtonMetres => {
            Dimension::Torque
        }
        C::SpindlePowerWatts | C::FeedDrivePowerWatts => Dimension::Power,
        C::SpindleCurrentAmperes | C::FeedDriveCurrentAmperes => Dimension::Current,
    }
}

/// Reads a quantity as `"7 kW"` and gives it in the unit of the API.
pub fn quantity(text: &str, dimension: Dimension) -> Result<f64, String> {
    let Some((number, unit)) = text.trim().split_once(char::is_whitespace) else {
        return Err(format!("{text:?} needs a number and a unit, as in \"7 kW\""));
    };
    let value: f64 = number.parse().map_err(|_| format!("{number:?} in {text:?} is not a number"))?;
    let unit = Unit::parse(unit.trim())?;
    if unit.dimension != dimension {
        return Err(format!("{text:?} is a {:?}, needed is a {dimension:?}", unit.dimension));
    }
    let converted = unit.convert(value);
    if converted.is_finite() { Ok(converted) } else { Err(format!("{text:?} is not finite")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9 * b.abs().max(1.0)
    }

    #[test]
    fn converts_into_the_unit_of_the_api() {
        for (unit, value, expected) in [
            ("mm/s", 6.0, 360.0),
            ("kW", 0.178, 178.0),
            ("rev/s", 53.3, 3198.0),
            ("rad/s", std::f64::consts::TAU, 60.0),
            ("ratio", 0.5, 50.0),
            ("in/min", 10.0, 254.0),
            ("s", 1.0, 1000.0),
            ("µm", 132.0, 0.132),
        ] {
            assert!(close(Unit::parse(unit).unwrap().convert(value), expected), "{unit}");
        }
        assert!(Unit::parse("KW").unwrap_err().contains("known are"));
    }

    #[test]
    fn a_quantity_needs_a_unit_of_its_kind() {
        assert!(close(quantity("7 kW", Dimension::Power).unwrap(), 7000.0));
        for wrong in ["7", "7kW", "x kW", "7 mm", "1e999 kW", "NaN kW"] {
            assert!(quantity(wrong, Dimension::Power).is_err(), "{wrong}");
        }
    }

    #[test]
    fn every_channel_has_units() {
        for &channel in Channel::ALL {
            let dimension = dimension_of(channel);
            let base = UNITS.iter().find(|(_, known, factor)| *known == dimension && close(*factor, 1.0));
            assert!(base.is_some(), "{channel:?}");
        }
    }
}
