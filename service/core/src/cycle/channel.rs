//! The channels that a cycle may be sampled in.

use crate::invalid::Range;

macro_rules! channels {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $word:literal, $min:literal ..= $max:literal, $unit:literal, $decimals:literal;)*) => {
        /// One sampled quantity. Its code is part of the stored format and never changes.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum Channel {
            $($(#[$doc])* $name = $code,)*
        }

        impl Channel {
            /// Every channel, in the order of the codes.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The field name in the API: the quantity with its unit last.
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }

            /// The channel of that field name.
            pub fn parse(text: &str) -> Option<Self> {
                match text { $($word => Some(Self::$name),)* _ => None }
            }

            /// The channel of that stored code.
            pub const fn from_code(code: u8) -> Option<Self> {
                match code { $($code => Some(Self::$name),)* _ => None }
            }

            /// Values outside are refused: no sensor of a machine tool gives them.
            pub const fn range(self) -> Range {
                match self { $(Self::$name => Range::new($min, $max, $unit),)* }
            }

            /// Decimals that controls usually quantise this channel to.
            pub const fn usual_decimals(self) -> u8 {
                match self { $(Self::$name => $decimals,)* }
            }
        }
    };
}

channels! {
    /// Tool tip depth z: 0 at first contact, positive into the work.
    DepthMm = 1, "depth_mm", -100_000.0 ..= 100_000.0, "mm", 3;
    /// Programmed feed F_pr.
    FeedProgrammedMmMin = 2, "feed_programmed_mm_min", 0.0 ..= 1_000_000.0, "mm/min", 0;
    /// Actual feed F; 0 is a hold, negative a retract.
    FeedActualMmMin = 3, "feed_actual_mm_min", -1_000_000.0 ..= 1_000_000.0, "mm/min", 0;
    /// Feed override applied, OVR; 0 is a hold.
    OverridePercent = 4, "override_percent", 0.0 ..= 1_000.0, "%", 0;
    /// The operator's override, which multiplies on top.
    OperatorOverridePercent = 5, "operator_override_percent", 0.0 ..= 1_000.0, "%", 0;
    /// Feed-drive load L_Z, percent of the machine's declared rating.
    FeedDriveLoadPercent = 6, "feed_drive_load_percent", -10_000.0 ..= 10_000.0, "%", 1;
    /// Spindle-drive load L_C, percent of the machine's declared rating.
    SpindleLoadPercent = 7, "spindle_load_percent", -10_000.0 ..= 10_000.0, "%", 1;
    /// Spindle speed S.
    SpindleSpeedRpm = 8, "spindle_speed_rpm", -1_000_000.0 ..= 1_000_000.0, "rpm", 0;
    /// Thrust F_a from a dynamometer.
    ThrustNewtons = 9, "thrust_newtons", -10_000_000.0 ..= 10_000_000.0, "N", 0;
    /// Torque T_a from a dynamometer.
    TorqueNewtonMetres = 10, "torque_newton_metres", -1_000_000.0 ..= 1_000_000.0, "N·m", 2;
    /// Spindle power.
    SpindlePowerWatts = 11, "spindle_power_watts", -10_000_000.0 ..= 10_000_000.0, "W", 0;
    /// Feed-drive power.
    FeedDrivePowerWatts = 12, "feed_drive_power_watts", -10_000_000.0 ..= 10_000_000.0, "W", 0;
    /// Spindle current.
    SpindleCurrentAmperes = 13, "spindle_current_amperes", -100_000.0 ..= 100_000.0, "A", 2;
    /// Feed-drive current.
    FeedDriveCurrentAmperes = 14, "feed_drive_current_amperes", -100_000.0 ..= 100_000.0, "A", 2;
    /// Torque of the feed drive's motor.
    FeedDriveTorqueNewtonMetres = 15, "feed_drive_torque_newton_metres", -1_000_000.0 ..= 1_000_000.0, "N·m", 2;
    /// Torque of the spindle's motor.
    SpindleTorqueNewtonMetres = 16, "spindle_torque_newton_metres", -1_000_000.0 ..= 1_000_000.0, "N·m", 2;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_codes_lead_back() {
        for &channel in Channel::ALL {
            assert_eq!(Channel::parse(channel.as_str()), Some(channel));
            assert_eq!(Channel::from_code(channel as u8), Some(channel));
        }
        assert_eq!(Channel::from_code(0), None);
        assert_eq!(Channel::parse("load"), None);
    }
}
