//! How far a replay is: a bar on a terminal, plain lines elsewhere.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};

/// Plain lines come once per this share of the whole.
const LINES: usize = 10;

/// A line for whoever looks, on standard error. Where nobody does any more the work goes on all the same.
pub fn tell(line: &str) {
    drop(writeln!(std::io::stderr().lock(), "{line}"));
}

/// Shows how far a replay is.
#[derive(Debug)]
pub enum Progress {
    /// On a terminal.
    Bar(ProgressBar),
    /// In a log.
    Lines {
        /// Cycles in all.
        total: usize,
        /// Cycles done.
        done: usize,
    },
    /// Nowhere.
    Silent,
}

impl Progress {
    /// A bar where standard error is a terminal, plain lines elsewhere.
    pub fn for_cycles(total: usize) -> Self {
        if !std::io::stderr().is_terminal() {
            return Self::Lines { total, done: 0 };
        }
        let style = "{bar:40} {pos}/{len} cycles  {per_sec}  {eta} left  {msg}";
        let bar = ProgressBar::new(total as u64);
        if let Ok(style) = ProgressStyle::with_template(style) {
            bar.set_style(style);
        }
        Self::Bar(bar)
    }

    /// `count` more cycles were answered, the last of them for `tool`.
    pub fn advance(&mut self, count: usize, tool: &str) {
        match self {
            Self::Bar(bar) => {
                bar.set_message(tool.to_owned());
                bar.inc(count as u64);
            }
            Self::Lines { total, done } => {
                let tenth = |done: usize| done * LINES / (*total).max(1);
                let before = tenth(*done);
                *done += count;
                if tenth(*done) > before {
                    tell(&format!("{done} of {total} cycles answered"));
                }
            }
            Self::Silent => {}
        }
    }

    /// Clears the bar.
    pub fn finish(&self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}
