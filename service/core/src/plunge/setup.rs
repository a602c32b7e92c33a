//! What an operation says about its plunge: the material, the drill, and the loop that has to sense contact.

use crate::field_error::FieldError;
use crate::ids::ModelId;

use super::{Drill, DrillInput, LoopLatency, LoopLatencyInput, Machine, Material, PlungeFeed, plunge_feed};

/// Version of the rules that make an advice of it.
pub const PLUNGE_LAW_VERSION: &str = "plunge-1";

/// How an operation plunges. The constants of the material stand in the library.
#[derive(Debug, Clone, PartialEq)]
pub struct PlungeSetup {
    /// Library entry.
    pub material: ModelId,
    /// The drill; its diameter is the operation's, whatever tool of that kind is mounted.
    pub drill: DrillInput,
    /// Delay of the loop; none where contact is sensed in the control itself.
    pub latency: Option<LoopLatencyInput>,
}

impl PlungeSetup {
    /// Checks everything.
    ///
    /// # Errors
    /// The first bad field, with its path.
    pub fn check(&self) -> Result<(), FieldError> {
        Drill::new(self.drill)?;
        self.latency.map(LoopLatency::new).transpose()?;
        Ok(())
    }

    /// The plunge feed on a machine with the constants of the entry.
    ///
    /// # Errors
    /// As [`PlungeSetup::check`].
    pub fn feed(&self, material: &Material, machine: &Machine) -> Result<PlungeFeed, FieldError> {
        let latency = self.latency.map(LoopLatency::new).transpose()?;
        Ok(plunge_feed(&Drill::new(self.drill)?, material, machine, latency.as_ref()))
    }
}
