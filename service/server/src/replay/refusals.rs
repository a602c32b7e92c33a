//! Cycles that a service did not take, counted by why.

use super::ReplayError;
use std::collections::BTreeMap;

/// How many cycles were not taken, by the code of the problem.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Refusals {
    by_code: BTreeMap<String, Told>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Told {
    count: u64,
    /// What was said of the first of them.
    first: String,
}

impl Refusals {
    /// Counts one; `said` is the problem in a line, which its code begins.
    pub fn count(&mut self, said: &str) {
        self.add(said, 1);
    }

    fn add(&mut self, said: &str, count: u64) {
        let code = said.split(':').next().unwrap_or(said).to_owned();
        self.by_code.entry(code).or_insert_with(|| Told { count: 0, first: said.to_owned() }).count += count;
    }

    /// Both together.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        other.by_code.values().for_each(|told| self.add(&told.first, told.count));
        self
    }

    /// Whether all of `posted` cycles were taken.
    ///
    /// # Errors
    /// Says how many were not, and the commonest reason.
    pub fn check(&self, posted: u64) -> Result<(), ReplayError> {
        let refused = self.by_code.values().map(|told| told.count).sum();
        let commonest = self.by_code.values().max_by_key(|told| told.count);
        commonest.map_or(Ok(()), |Told { count, first }| {
            Err(ReplayError::NotTaken { refused, posted, alike: *count, first: first.clone() })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_how_many_were_refused_and_the_commonest_reason() {
        let mut one = Refusals::default();
        assert!(one.check(3).is_ok());
        one.count("forbidden: another machine's token");
        let mut other = Refusals::default();
        other.count("future: tomorrow");
        other.count("future: the day after");
        let error = one.plus(&other).check(9).unwrap_err().to_string();
        assert_eq!(error, "3 of 9 cycles were refused, 2 of them as this one: future: tomorrow");
    }
}
