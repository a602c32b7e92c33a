//! One hole of a simple G-code program, as stretches of one feed each.
//!
//! A block is read whole ([`Block`]), then run ([`Reader`]). Controls differ in what they do with a block that is odd, so
//! odd blocks are refused: what LinuxCNC's `rs274` calls an error is one here too, and so is what other controls read
//! otherwise. What a word has to say is decided in [`Block::code`] and [`Block::function`]: a new one is added there.

use super::{Held, at_line, bounded, number};
use crate::invalid::Violation;

/// Words of a kind that are listed at most.
const MOST_LISTED: usize = 50;

/// What was read of a program beside its feeds, for a person to look at.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hole {
    /// Its stretches.
    pub held: Vec<Held>,
    /// Words that say nothing about the feed and were passed over, once each.
    pub passed_over: Vec<String>,
    /// Depths without a decimal point, once each. They were read as mm; FANUC and others may be set to read them in steps of
    /// 0.001 mm.
    pub without_point: Vec<String>,
}

/// A stable code and the reason.
type Refusal = (&'static str, String);

/// Refused because it may mean something else on the control, or nothing.
fn unclear<T>(why: impl Into<String>) -> Result<T, Refusal> {
    Err(("not_understood", why.into()))
}

/// Refused although it is clear: it is no feed over depth.
fn no_feed<T>(why: impl Into<String>) -> Result<T, Refusal> {
    Err(("not_a_feed_over_depth", why.into()))
}

/// One hole of a simple program: `G0`, `G1`, `G81`, `G80`, `G90`, `G94`, `G21`, `G71`, `G710`, `G17`, `F`, `Z`, `R`.
///
/// Comments in parentheses and behind a semicolon are passed over, as are X and Y of rapid moves above the work, S, T, N, H,
/// D, one program number, `%` around the program, and what `G64` says of rounding. `contact_z_mm` is the Z of first contact.
/// Pecking (`G73`, `G83`), dwells (`G4`, `G82`), feed per revolution (`G95`), increments (`G91`), inches (`G20`, `G70`),
/// variables, loops, calls and a second hole are refused: none of them is a feed over depth. So is whatever stands behind the
/// program's end, moves where the depth is measured from while the tool is in the work, or is read in two ways.
///
/// # Errors
/// With the line and the word that is not understood.
pub fn gcode(text: &str, contact_z_mm: f64) -> Result<Hole, Vec<Violation>> {
    bounded(text)?;
    if !contact_z_mm.is_finite() {
        return Err(vec![Violation::new("contact_z_mm", "not_finite", "must be a finite number")]);
    }
    let mut reader = Reader { contact_mm: contact_z_mm, ..Reader::default() };
    // A byte order mark is how some editors begin.
    let text = text.trim_start_matches('\u{feff}');
    for (at, line) in text.lines().enumerate().map(|(at, line)| (at + 1, line)) {
        if line.trim() == "%" {
            reader.percent();
            continue;
        }
        let words = words(line).map_err(|why| at_line(at, "not_understood", why))?;
        reader.line(&words).map_err(|(code, why)| at_line(at, code, why))?;
    }
    if reader.hole.held.is_empty() {
        return Err(vec![Violation::new("text", "too_few", "holds no move below first contact")]);
    }
    Ok(reader.hole)
}

/// A letter with its number, and whether that has a decimal point.
#[derive(Debug, Clone, Copy)]
struct Word {
    letter: char,
    value: f64,
    has_point: bool,
}

fn words(line: &str) -> Result<Vec<Word>, String> {
    let mut words = Vec::new();
    // Behind a comment it would hide a block from one reader and not from another.
    if line.trim_end().contains('\r') {
        return Err("a carriage return stands within the line".to_owned());
    }
    let line = line.split(';').next().unwrap_or_default().trim().to_ascii_uppercase();
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            ' ' | '\t' => {}
            '(' => match letters.by_ref().find(|letter| matches!(letter, '(' | ')')) {
                Some(')') => {}
                Some(_) => return Err("a comment begins within a comment".to_owned()),
                None => return Err("a comment does not end in its line".to_owned()),
            },
            'A'..='Z' => {
                let mut text = String::new();
                while let Some(next) =
                    letters.next_if(|next| next.is_ascii_digit() || matches!(next, '.' | '-' | '+' | ' '))
                {
                    if next != ' ' {
                        text.push(next);
                    }
                }
                let value = number(&text).ok_or_else(|| format!("`{letter}` is not followed by a number"))?;
                words.push(Word { letter, value, has_point: text.contains('.') });
            }
            '#' | '[' | ']' | '=' => return Err("variables and expressions are not read".to_owned()),
            other => return Err(format!("`{}` is not understood", other.escape_default())),
        }
    }
    Ok(words)
}

/// The number of a code: whole and without a sign, so that `G0.96` is not taken for `G1`.
fn whole(value: f64) -> Option<u32> {
    let is_code = value.is_sign_positive() && value <= 9999.0 && value.fract() == 0.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole, from 0 to 9999")]
    is_code.then_some(value as u32)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Motion {
    /// `G0`.
    Rapid,
    /// `G1`.
    Feed,
    /// `G81`.
    Drill,
}

/// What only one word of a block may set, one bit each. `G80` is apart from the motions: safety blocks hold it with `G0`.
mod group {
    pub(super) const MOTION: u32 = 1;
    pub(super) const CYCLE_END: u32 = 1 << 1;
    pub(super) const PLANE: u32 = 1 << 2;
    pub(super) const DISTANCE: u32 = 1 << 3;
    pub(super) const FEED_MODE: u32 = 1 << 4;
    pub(super) const UNITS: u32 = 1 << 5;
    pub(super) const RADIUS: u32 = 1 << 6;
    pub(super) const LENGTH: u32 = 1 << 7;
    pub(super) const RETURN: u32 = 1 << 8;
    pub(super) const OFFSET: u32 = 1 << 9;
    pub(super) const PATH: u32 = 1 << 10;
    pub(super) const STOP: u32 = 1 << 16;
    pub(super) const TOOL: u32 = 1 << 17;
    pub(super) const SPINDLE: u32 = 1 << 18;
    pub(super) const COOLANT: u32 = 1 << 19;
    pub(super) const GEAR: u32 = 1 << 20;
    pub(super) const OVERRIDE: u32 = 1 << 21;
}

/// What a block says, before it is run.
#[derive(Default)]
struct Block {
    z: Option<f64>,
    feed: Option<f64>,
    retract: Option<f64>,
    sideways: bool,
    motion: Option<Motion>,
    /// `G80`.
    ends_cycle: bool,
    /// G words that say what numbers mean: plane, distances, units, feed.
    modes: Vec<u32>,
    /// `G98` or `G99`.
    return_to: Option<u32>,
    /// A word that changes the tool or where Z0 lies.
    reference: Option<String>,
    /// `M0` or `M1`.
    stop: Option<String>,
    /// `M2`, `M30`, `M17` or `M99`.
    ends: bool,
    /// `O`.
    program: bool,
    groups: u32,
}

impl Block {
    fn read(words: &[Word]) -> Result<Self, Refusal> {
        let mut block = Self::default();
        // What G64's P and Q bound is how far corners are rounded: a hole has none.
        let rounds = words.iter().any(|word| word.letter == 'G' && whole(word.value) == Some(64));
        for (at, &Word { letter, value, .. }) in words.iter().enumerate() {
            let word = || format!("{letter}{value}");
            // Of two words one would be passed over, and nobody could say which.
            if !matches!(letter, 'G' | 'M') && words[..at].iter().any(|before| before.letter == letter) {
                return unclear(format!("the word {letter} stands twice in the block"));
            }
            match letter {
                'G' => block.code(value)?,
                'M' => block.function(value)?,
                'Z' => block.z = Some(value),
                'F' if value > 0.0 => block.feed = Some(value),
                'F' => return Err(("out_of_range", "a feed must be above 0".to_owned())),
                'R' => block.retract = Some(value),
                'X' | 'Y' => block.sideways = true,
                'P' | 'Q' if rounds => {}
                'P' | 'Q' => {
                    return no_feed(format!("{}: dwells, pecks and repeats are no feed over depth", word()));
                }
                'L' | 'K' => return no_feed(format!("{}: repeats are no feed over depth", word())),
                'N' if at > 0 => return unclear("N has to begin its block"),
                'O' if words.len() > 1 => return unclear("O has to stand alone in its block"),
                'N' | 'S' if value >= 0.0 => {}
                'O' | 'T' | 'H' | 'D' if whole(value).is_some() => {
                    block.program |= letter == 'O';
                    if letter != 'O' {
                        block.reference.get_or_insert_with(word);
                    }
                }
                'N' | 'S' | 'O' | 'T' | 'H' | 'D' => return unclear(format!("{} is not read", word())),
                other => return unclear(format!("the word {other} is not read")),
            }
        }
        if block.ends_cycle && matches!(block.motion, Some(Motion::Feed | Motion::Drill)) {
            return unclear("G80 in one block with G1 or G81");
        }
        // One control drills at the depth of before, another stops.
        if block.motion == Some(Motion::Drill) && block.z.is_none() {
            return unclear("G81 needs its Z in the same block");
        }
        Ok(block)
    }

    fn claim(&mut self, groups: u32, word: &str) -> Result<(), Refusal> {
        if self.groups & groups != 0 {
            return unclear(format!(
                "{word} is one word too many: of its group only one may stand in a block"
            ));
        }
        self.groups |= groups;
        Ok(())
    }

    /// A G word.
    fn code(&mut self, value: f64) -> Result<(), Refusal> {
        let word = format!("G{value}");
        let Some(code) = whole(value) else { return unclear(format!("{word} is not read")) };
        let group = match code {
            0 | 1 | 81 => group::MOTION,
            80 => group::CYCLE_END,
            17 => group::PLANE,
            90 => group::DISTANCE,
            94 => group::FEED_MODE,
            21 | 71 | 710 => group::UNITS,
            40 => group::RADIUS,
            43 | 49 => group::LENGTH,
            54..=59 => group::OFFSET,
            61 | 64 => group::PATH,
            98 | 99 => group::RETURN,
            91 => return no_feed("G91: depths have to be absolute"),
            20 | 70 | 700 => return no_feed("inches: give it in mm"),
            95 => return no_feed("G95: the feed has to be per minute"),
            4 | 82 => return no_feed("a dwell is no feed over depth"),
            73 | 83 => return no_feed("pecking is no feed over depth"),
            _ => return unclear(format!("{word} is not read")),
        };
        self.claim(group, &word)?;
        match group {
            group::MOTION => {
                self.motion = Some(match code {
                    0 => Motion::Rapid,
                    1 => Motion::Feed,
                    _ => Motion::Drill,
                });
            }
            group::CYCLE_END => self.ends_cycle = true,
            group::PLANE | group::DISTANCE | group::FEED_MODE | group::UNITS => self.modes.push(code),
            group::LENGTH | group::OFFSET => {
                self.reference.get_or_insert(word);
            }
            group::RETURN => self.return_to = Some(code),
            _ => {}
        }
        Ok(())
    }

    /// An M word. Only those are passed over that no control is known to move or to call a program by.
    fn function(&mut self, value: f64) -> Result<(), Refusal> {
        let word = format!("M{value}");
        let groups = match whole(value) {
            Some(0 | 1 | 2 | 17 | 30 | 99) => group::STOP,
            Some(3 | 4 | 5 | 19) => group::SPINDLE,
            Some(6) => group::TOOL,
            Some(7..=9) => group::COOLANT,
            // The spindle and the coolant together.
            Some(13 | 14) => group::SPINDLE | group::COOLANT,
            Some(40..=45) => group::GEAR,
            Some(48 | 49) => group::OVERRIDE,
            Some(96..=98 | 198) => return no_feed("calls are not followed: give the called program"),
            _ => return unclear(format!("{word} is not read: what it does is not known")),
        };
        self.claim(groups, &word)?;
        match whole(value) {
            Some(0 | 1) => self.stop = Some(word),
            Some(2 | 17 | 30 | 99) => self.ends = true,
            Some(6) => {
                self.reference.get_or_insert(word);
            }
            _ => {}
        }
        Ok(())
    }
}

/// Where a program is while it is read.
#[derive(Default)]
struct Reader {
    contact_mm: f64,
    z: Option<f64>,
    feed: Option<f64>,
    /// Motion in force; none at the beginning and behind `G80`.
    motion: Option<Motion>,
    retract: Option<f64>,
    /// What numbers mean, as far as it was said.
    modes: Vec<u32>,
    return_to: Option<u32>,
    /// Whether the hole is drilled and left.
    done: bool,
    /// Blocks that were read.
    blocks: usize,
    /// Whether a block or the first `%` was read.
    begun: bool,
    /// Whether the program's end was read: `M2`, `M30`, `M17`, `M99` or the second `%`.
    ended: bool,
    hole: Hole,
}

impl Reader {
    /// A `%` alone in its line: the beginning where nothing stands before it, otherwise the end.
    fn percent(&mut self) {
        self.ended |= self.begun;
        self.begun = true;
    }

    fn in_hole(&self) -> bool {
        self.z.is_some_and(|z| z < self.contact_mm)
    }

    fn line(&mut self, words: &[Word]) -> Result<(), Refusal> {
        if words.is_empty() {
            return Ok(());
        }
        if self.ended {
            return no_feed(
                "holds blocks behind the program's end (M2, M30, M17, M99, %): give one program alone",
            );
        }
        let block = Block::read(words)?;
        if block.program && self.blocks > 0 {
            return no_feed("a program number behind blocks: give one program alone");
        }
        self.begun = true;
        self.blocks += 1;
        self.list(words);
        self.run(&block)
    }

    fn list(&mut self, words: &[Word]) {
        let Hole { passed_over, without_point, .. } = &mut self.hole;
        for &Word { letter, value, has_point } in words {
            let listed = match letter {
                'M' | 'S' | 'T' | 'O' | 'H' | 'D' | 'P' | 'Q' => &mut *passed_over,
                'Z' | 'R' if !has_point && value != 0.0 => &mut *without_point,
                _ => continue,
            };
            let word = format!("{letter}{value}");
            if !listed.contains(&word) && listed.len() < MOST_LISTED {
                listed.push(word);
            }
        }
    }

    fn run(&mut self, block: &Block) -> Result<(), Refusal> {
        let (in_hole, stretches) = (self.in_hole(), self.hole.held.len());
        self.set(block)?;
        self.go(block)?;
        let cuts = self.hole.held.len() > stretches;
        if let Some(word) = &block.reference
            && (in_hole || cuts)
        {
            return no_feed(format!("{word} changes the tool or where Z0 lies while the hole is cut"));
        }
        if let Some(word) = &block.stop
            && self.in_hole()
        {
            return no_feed(format!("{word}: a stop in the hole is no feed over depth"));
        }
        self.ended |= block.ends;
        Ok(())
    }

    /// What holds from this block on, before it moves.
    fn set(&mut self, block: &Block) -> Result<(), Refusal> {
        for code in &block.modes {
            if !self.modes.contains(code) {
                // What was cut before it was meant in something that nobody said.
                if self.in_hole() {
                    return unclear(format!("G{code} is said in the hole for the first time"));
                }
                self.modes.push(*code);
            }
        }
        self.return_to = block.return_to.or(self.return_to);
        if block.reference.is_some() && !self.in_hole() {
            // Where the tool stands was told in what held before.
            self.z = None;
        }
        if block.motion.is_some() || block.ends_cycle {
            self.motion = block.motion;
        }
        if self.motion != Some(Motion::Drill) {
            self.retract = None;
        }
        if block.retract.is_some() && (self.motion != Some(Motion::Drill) || block.z.is_none()) {
            return unclear("R without G81 and its Z, which use it");
        }
        self.retract = block.retract.or(self.retract);
        if block.modes.contains(&94) {
            // LinuxCNC and SINUMERIK forget the feed with it.
            self.feed = None;
        }
        self.feed = block.feed.or(self.feed);
        Ok(())
    }

    fn go(&mut self, block: &Block) -> Result<(), Refusal> {
        if block.z.is_none() && !block.sideways {
            return Ok(());
        }
        if block.sideways && self.in_hole() {
            return no_feed("a move sideways in the work is no hole");
        }
        match (self.motion, block.z) {
            (None, _) => unclear("X, Y or Z without G0, G1 or G81 before it"),
            (Some(Motion::Feed), _) if block.sideways => no_feed("a cut sideways is no hole"),
            (Some(Motion::Feed), Some(z)) => self.feed_to(z),
            (Some(Motion::Drill), _) if !self.hole.held.is_empty() => {
                no_feed("holds a second hole: give one alone")
            }
            (Some(Motion::Drill), Some(z)) => self.drill(z),
            (Some(Motion::Rapid), Some(z)) => {
                if z < self.contact_mm && self.z.is_none_or(|now| z < now) {
                    return no_feed("a rapid move goes below first contact");
                }
                self.done |= !self.hole.held.is_empty();
                self.z = Some(z);
                Ok(())
            }
            (_, None) => Ok(()),
        }
    }

    fn drill(&mut self, z: f64) -> Result<(), Refusal> {
        let Some(retract) = self.retract else {
            return no_feed("G81 needs its R: where the feed begins");
        };
        if retract < self.contact_mm {
            return no_feed("R lies below first contact: the rapid would hit the work");
        }
        if z >= retract {
            return unclear("Z of G81 has to lie below its R");
        }
        self.z = Some(retract);
        self.cut(z)?;
        self.done = true;
        self.z = Some(retract);
        Ok(())
    }

    fn feed_to(&mut self, z: f64) -> Result<(), Refusal> {
        // FANUC's lathes mean the feed per revolution by it; who says G94 too means where a cycle returns to.
        if self.return_to == Some(99) && !self.modes.contains(&94) {
            return unclear("G99 with G1 and without G94: the feed may be per revolution");
        }
        self.cut(z)
    }

    fn cut(&mut self, z: f64) -> Result<(), Refusal> {
        let feed_mm_min = self.feed.ok_or(("not_understood", "a cut without a feed".to_owned()))?;
        let from = self.z.unwrap_or(self.contact_mm);
        // Without the last bits of the difference: 0.1 − (−0.2) is 0.3.
        let depth = ((self.contact_mm - z) * 1e9).round() / 1e9;
        self.z = Some(z);
        if z >= from || depth <= 0.0 {
            // A way up, or still above the work.
            self.done |= z > from && !self.hole.held.is_empty();
            return Ok(());
        }
        if self.done {
            return no_feed("holds a second hole: give one alone");
        }
        if self.hole.held.is_empty() && from < self.contact_mm {
            return unclear("the first cut begins below first contact");
        }
        self.hole.held.push(Held { to_mm: depth, feed_mm_min });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn refused(text: &str) -> (String, &'static str) {
        let wrong = gcode(text, 0.0).unwrap_err();
        (wrong[0].path.clone(), wrong[0].code)
    }

    /// Every one is refused in that line, with that code and a reason that holds `why`.
    fn all_refused(line: usize, code: &str, why: &str, texts: &[&str]) {
        for text in texts {
            let wrong = gcode(text, 0.0).expect_err(text);
            let is = (wrong[0].path.as_str(), wrong[0].code);
            assert_eq!(is, (format!("text:line {line}").as_str(), code), "{text}: {}", wrong[0].message);
            assert!(wrong[0].message.contains(why), "{text}: {}", wrong[0].message);
        }
    }

    fn stretches(text: &str) -> Vec<(f64, f64)> {
        let hole = gcode(text, 0.0).expect(text);
        hole.held.iter().map(|one| (one.to_mm, one.feed_mm_min)).collect()
    }

    #[test]
    fn a_hole_in_blocks_is_read_from_contact_on() {
        let text = "%\nO1234 (BUSHING M8)\nN10 G21 G90 G94 T5 M6\nN20 S2800 M3\nG0 X10. Y20. Z5.\nG1 Z0.5 F1000.\n\
                    G1 Z-3. F160. ; heating\nZ-8.0 F480\nG01Z-20.5F150\nG0 Z50.\nM5\nM30\n%\n";
        let hole = gcode(text, 0.0).unwrap();
        let held: Vec<_> = hole.held.iter().map(|one| (one.to_mm, one.feed_mm_min)).collect();
        assert_eq!(held, [(3.0, 160.0), (8.0, 480.0), (20.5, 150.0)]);
        assert_eq!(hole.passed_over, ["O1234", "T5", "M6", "S2800", "M3", "M5", "M30"]);
        // Editors begin with a byte order mark, end lines in two ways, and a tape ends with a percent sign.
        let same = gcode(&format!("\u{feff}{}", text.replace('\n', "\r\n")), 0.0).unwrap();
        assert_eq!(same, hole);
        // How far corners are rounded is nothing that a hole has.
        let rounded = gcode(&text.replace("G21 G90", "G64 P0.01 Q0.02 G21 G90"), 0.0).unwrap();
        assert_eq!(rounded.held, hole.held);
        assert_eq!(rounded.passed_over[..3], ["O1234", "P0.01", "Q0.02"]);
        // First contact may lie elsewhere than at Z0.
        assert!((gcode("G1 Z-1 F100", 2.0).unwrap().held[0].to_mm - 3.0).abs() < 1e-12);
    }

    #[test]
    fn depths_without_a_point_are_named() {
        let hole = gcode("G0 Z10\nG81 X1 Y2 R1 Z-20 F120\nG80\nG0 Z10\n", 0.0).unwrap();
        assert_eq!(hole.without_point, ["Z10", "R1", "Z-20"]);
        let clear = gcode("G0 Z10.\nG1 Z0 F1000\nG1 Z-3.5 F160\nG0 Z10.0\nG0 X0 Y0\n", 0.0).unwrap();
        assert_eq!(
            clear.without_point, [""; 0],
            "nothing is nothing in any unit, and feeds are per minute in mm"
        );
        let steps: String = (1..=60).map(|step| format!("G1 Z-{step} F100\n")).collect();
        assert_eq!(gcode(&steps, 0.0).unwrap().without_point.len(), MOST_LISTED);
    }

    #[test]
    fn a_drilling_cycle_is_one_feed() {
        let hole = gcode("G90 G94\nG0 Z10\nG81 X1 Y2 R1. Z-20.5 F120.\nG80\nG0 Z50\n", 0.0).unwrap();
        assert_eq!(hole.held, [Held { to_mm: 20.5, feed_mm_min: 120.0 }]);
    }

    #[test]
    fn what_is_no_feed_over_depth_is_refused_with_its_line() {
        assert_eq!(refused("G83 Z-10 R1 Q2 F100").1, "not_a_feed_over_depth");
        assert_eq!(refused("G0 Z1\nG82 Z-10 R1 P500 F100"), ("text:line 2".into(), "not_a_feed_over_depth"));
        assert_eq!(refused("G91\nG1 Z-1 F100"), ("text:line 1".into(), "not_a_feed_over_depth"));
        let why = gcode("G1 Z-1 F100 P500", 0.0).unwrap_err();
        assert_eq!(why[0].message, "P500: dwells, pecks and repeats are no feed over depth");
        assert_eq!(refused("G64 P0.01 L3\nG1 Z-1 F100"), ("text:line 1".into(), "not_a_feed_over_depth"));
        assert_eq!(refused("G95 F0.1\nG1 Z-1"), ("text:line 1".into(), "not_a_feed_over_depth"));
        assert_eq!(refused("G20\nG1 Z-1 F10"), ("text:line 1".into(), "not_a_feed_over_depth"));
        assert_eq!(refused("G1 Z-1 X5 F100"), ("text:line 1".into(), "not_a_feed_over_depth"));
        assert_eq!(refused("G0 Z-1"), ("text:line 1".into(), "not_a_feed_over_depth"));
        assert_eq!(
            refused("G1 Z-5 F100\nG0 Z5\nX10\nG1 Z-5"),
            ("text:line 4".into(), "not_a_feed_over_depth")
        );
        assert_eq!(refused("G81 X1 R1 Z-5 F100\nX2"), ("text:line 2".into(), "not_a_feed_over_depth"));
        assert_eq!(refused("G1 Z#101 F100"), ("text:line 1".into(), "not_understood"));
        assert_eq!(refused("G1 Z-1"), ("text:line 1".into(), "not_understood"));
        assert_eq!(refused("WHILE [1] DO1"), ("text:line 1".into(), "not_understood"));
        assert_eq!(refused("G2 X1 I1 F100"), ("text:line 1".into(), "not_understood"));
        assert_eq!(refused("(open"), ("text:line 1".into(), "not_understood"));
        assert_eq!(refused("M30").1, "too_few");
        // What could be meant in two ways is refused rather than guessed.
        assert_eq!(refused("G1 Z-20.5 F100 Z-10").1, "not_understood");
        assert_eq!(refused("G1 Z-20.5 F100 F900").1, "not_understood");
        assert_eq!(refused("G0 G1 Z-20.5 F100").1, "not_understood");
        assert_eq!(
            refused("G1 Z-20.5 F100\nM30\n%\nG1 Z-30 F900"),
            ("text:line 4".into(), "not_a_feed_over_depth")
        );
        assert_eq!(refused("G1 Z-5 F100\nM98 P1000").1, "not_a_feed_over_depth");
        assert_eq!(refused("M98").1, "not_a_feed_over_depth");
        assert_eq!(refused("FLIN\nG1 Z-1 F100").1, "not_understood");
        assert_eq!(gcode("G1 Z-1 F1", f64::NAN).unwrap_err()[0].code, "not_finite");
    }

    #[test]
    fn a_program_ends_at_its_second_percent_sign_and_at_every_end_that_a_control_knows() {
        let behind = "behind the program's end";
        all_refused(
            6,
            "not_a_feed_over_depth",
            behind,
            &[
                "%\nG21 G90 G94\nG0 Z1\nG1 Z-5 F100\n%\nG1 Z-10 F300\n%\n",
                "O1\nG21 G90 G94\nG0 Z1\nG1 Z-5 F100\n%\nG1 Z-10 F300\n",
                "O1\nG21 G90 G94\nG0 Z1\nG1 Z-5 F100\nM99\nG1 Z-10 F300\nM2\n",
                "O1\nG21 G90 G94\nG0 Z1\nG1 Z-5 F100\nM17\nG1 Z-10 F300\nM2\n",
                "O1\nG21 G90 G94\nG0 Z1\nG1 Z-5 F100\nM99\nO0002\nG1 Z-10 F300\nM99\n",
                "O1\nG21 G90 G94\nG0 Z1\nG1 Z-5 F100 M30\n%\nM5\n",
            ],
        );
        all_refused(
            4,
            "not_a_feed_over_depth",
            behind,
            &["G21 G90 G94\nG0 Z1\nM99\nG01\nF300.\nG1\nZ-12.25 F300.\nM2\n", "%\n%\n\nG1 Z-5 F100\n%\n"],
        );
        // What a SINUMERIK also calls the end is no word of this reader.
        assert_eq!(refused("G1 Z-5 F100\nRET"), ("text:line 2".into(), "not_understood"));
        // A percent sign that is not alone in its line is none.
        assert_eq!(refused("% ; tape\nG1 Z-5 F100"), ("text:line 1".into(), "not_understood"));
        // A tape, a subprogram, and a file that lost its first sign.
        for text in
            ["(A)\n%\nO1\nG1 Z-5 F100\nM99\n%\n\n", "G1 Z-5 F100\nM17 ; end\n", "G1 Z-5 F100\nM30\n%\n(B)"]
        {
            assert_eq!(stretches(text), [(5.0, 100.0)], "{text}");
        }
    }

    #[test]
    fn a_second_program_is_refused() {
        let why = "give one program alone";
        all_refused(
            3,
            "not_a_feed_over_depth",
            why,
            &["O0001\nG1 Z-5 F100\nO0002\nG1 Z-10 F300\nM30\n", "O0001\nG1 Z-5 F100\nO0001\n"],
        );
        all_refused(
            2,
            "not_a_feed_over_depth",
            why,
            &["O0001\nO0002\nG1 Z-5 F100", "G21\nO0001\nG1 Z-5 F100"],
        );
        all_refused(
            1,
            "not_understood",
            "",
            &["O1 G1 Z-5 F100", "O1 O2\nG1 Z-5 F100", "O1.5\nG1 Z-5 F100", "O-1\nG1 Z-5 F100"],
        );
    }

    #[test]
    fn a_rapid_move_sideways_in_the_work_is_refused() {
        let why = "sideways in the work";
        let begin = |block: &str| format!("G21 G90 G94\nG0 Z1\nG1 Z-5 F100\n{block}\nG1 Z-10 F300\nM2\n");
        for block in ["G0 X10", "G0 Y-2.", "G0 X10 Z50", "X10", "G81 X1 R1 Z-10"] {
            all_refused(4, "not_a_feed_over_depth", why, &[&begin(block)]);
        }
        // Above the work it is the way to the hole and home.
        let home = "G21 G90 G94\nG0 X1 Y2\nX3 Z1\nG1 Z-5 F100\nG0 Z1\nX0 Y0 Z50\nM2\n";
        assert_eq!(stretches(home), [(5.0, 100.0)]);
    }

    #[test]
    fn the_tool_and_where_z0_lies_stay_while_the_hole_is_cut() {
        let why = "changes the tool or where Z0 lies";
        let all = "T2 M6|T2|M6|G43 H2|G43|H2|G49|D2|D0|G54|G55|G56|G57|G58|G59|G0 G49 Z50|G1 Z-7 F50 G54";
        for word in all.split('|') {
            let text = format!("G21 G90 G94\nG0 Z1\nG1 Z-5 F100\n{word}\nG1 Z-10 F300\nM2\n");
            all_refused(4, "not_a_feed_over_depth", why, &[&text]);
            // Before the first cut and once the hole is left it is how a program begins and ends.
            if !word.contains('Z') {
                let before = format!("G21 G90 G94\n{word}\nG0 Z1\n{word}\nG1 Z-5 F100\nG0 Z1\n{word}\nM2\n");
                assert_eq!(stretches(&before), [(5.0, 100.0)], "{word}");
            }
        }
        // In the block that cuts nobody can say which comes first.
        all_refused(
            2,
            "not_a_feed_over_depth",
            why,
            &["G0 Z1\nG1 Z-5 F100 M6", "G0 Z1\nG1 Z-5 F100 G43 H2", "G90\nG81 X1 Z-5 R1 F100 G54"],
        );
        // Behind it nobody knows how high the tool stands.
        let after = "G0 Z1\nG1 Z-5 F100\nG0 Z1\nG55\nG1 Z-4";
        assert_eq!(refused(after), ("text:line 5".into(), "not_a_feed_over_depth"));
        // Offsets that are no G54 to G59 are not read at all.
        for word in ["G54.1 P1", "G59.1", "G500", "G52 Z1", "G92 Z0", "G53 Z0", "G10 L2"] {
            assert!(gcode(&format!("{word}\nG1 Z-5 F100"), 0.0).is_err(), "{word}");
        }
    }

    #[test]
    fn only_exact_codes_are_known() {
        for word in ["G0.96", "G0.04", "G-1", "G-0", "G1.04", "G80.96", "G90.1", "G99999", "G2147483649"] {
            all_refused(1, "not_understood", "is not read", &[&format!("{word} Z-5 F100")]);
        }
        for word in ["M2.4", "M29.6", "M-30", "M98.6", "M1.5", "T-1", "T1.5", "H-1", "D0.5", "S-100", "N-1"] {
            all_refused(1, "not_understood", "is not read", &[&format!("{word} G1 Z-5 F100")]);
        }
        assert_eq!(stretches("N1.5 G01. Z-5 F100 M05."), [(5.0, 100.0)]);
        assert_eq!(stretches("G90.0 G001 Z-5 F100"), [(5.0, 100.0)]);
    }

    #[test]
    fn r_is_refused_where_no_cycle_uses_it() {
        let why = "R without G81 and its Z";
        all_refused(2, "not_understood", why, &["G0 Z1\nG1 Z-5 R2 F100", "G0 Z1\nR2\nG81 Z-5 F100"]);
        all_refused(2, "not_understood", why, &["G81 Z-5 R1 F100\nR2", "G81 Z-5 R1 F100\nX2 R2"]);
        all_refused(2, "not_understood", why, &["G81 Z-5 R1 F100\nG80 R1", "G81 Z-5 R1 F100\nG0 R1 Z5"]);
        // R goes with its cycle.
        all_refused(3, "not_a_feed_over_depth", "needs its R", &["G81 Z0 R1 F100\nG80\nG81 Z-5 F100"]);
        let alone = ["G81", "G81 F100\nZ-5 R1", "G81 X1 R1 F100\nZ-5"];
        all_refused(1, "not_understood", "needs its Z", &alone);
        all_refused(1, "not_understood", "below its R", &["G81 Z5 R2 F100", "G81 Z2 R2 F100"]);
    }

    #[test]
    fn a_block_says_one_thing_of_each_kind() {
        let why = "one word too many";
        for words in "G1F300.G1|G1 G81 R1|G0 G0|G21 G71|G21 G21|G17 G17|G90 G90|G94 G94|G40 G40|G43 G49|G54 G55|G61 G64|\
                      G98 G99|G80 G80|M3 M4|M3 M3|M7 M8|M8 M9|M13 M3|M13 M8|M0 M1|M5 M0 M30|M40 M41|M48 M49|M6 M6"
            .split('|')
        {
            all_refused(1, "not_understood", why, &[&format!("{words} Z-5")]);
        }
        for letter in "ZFXYRSTNHDPQ".chars() {
            let text = format!("{letter}1 {letter}1 G64");
            all_refused(1, "not_understood", "stands twice", &[&text]);
        }
        all_refused(1, "not_understood", "G80 in one block", &["G1 G80 Z-5 F100", "G80 G81 Z-5 R1 F100"]);
        all_refused(1, "not_understood", "N has to begin", &["G1 Z-5 N10 F100"]);
        // Safety blocks are one word of each kind, and so is a program's end.
        let safe = "G0 G17 G21 G40 G49 G80 G90 G94 G98\nG54 G0 Z1 M3 M8\nG1 Z-5 F100\nG80 G0 Z5\nM5 M9 M30\n";
        assert_eq!(stretches(safe), [(5.0, 100.0)]);
    }

    #[test]
    fn behind_g80_a_motion_has_to_be_said_again() {
        let why = "without G0, G1 or G81";
        all_refused(3, "not_understood", why, &["G0 Z1\nG80\nZ5\nG1 Z-5 F100", "G81 Z-5 R1 F100\nG80\nX5"]);
        all_refused(1, "not_understood", why, &["X1", "Z-5 F100", "G80 Z50"]);
    }

    #[test]
    fn only_functions_that_move_nothing_are_passed_over() {
        let calls = ["M96 P100", "M97 P100", "M98", "M98 P1000", "M198 P5"];
        for call in calls {
            all_refused(
                2,
                "not_a_feed_over_depth",
                "calls are not followed",
                &[&format!("G1 Z-5 F100\n{call}")],
            );
        }
        for word in "M10 M11 M18 M20 M29 M31 M50 M52 M60 M70 M80 M97.5 M100 M101 M999".split(' ') {
            all_refused(2, "not_understood", "is not read", &[&format!("G0 Z1\n{word}\nG1 Z-5 F100")]);
        }
        let hole = gcode("M48\nM41 M13\nG1 Z-5 F100 M8\nM9\nM19\nM5\nM0\nM2", 0.0);
        assert_eq!(hole.unwrap_err()[0].path, "text:line 7", "it stops in the hole");
        let hole = gcode("M0\nM48\nM41 M13\nG1 Z-5 F100 M8\nM9\nM19\nG0 Z1 M1\nM2", 0.0).unwrap();
        assert_eq!(hole.passed_over, ["M0", "M48", "M41", "M13", "M8", "M9", "M19", "M1", "M2"]);
    }

    #[test]
    fn a_stop_in_the_hole_is_refused_as_a_dwell_is() {
        let why = "a stop in the hole";
        all_refused(2, "not_a_feed_over_depth", why, &["G1 Z-5 F100\nM0\nG1 Z-10", "G1 Z-5 F100\nM1"]);
        all_refused(2, "not_a_feed_over_depth", why, &["G0 Z1\nG1 Z-5 F100 M0", "G1 Z-5 F100\nG0 Z-3 M1"]);
        assert_eq!(stretches("G0 Z1 M1\nG1 Z-5 F100\nG0 Z1 M0"), [(5.0, 100.0)]);
    }

    #[test]
    fn what_numbers_mean_is_not_said_in_the_hole_for_the_first_time() {
        for code in [17, 21, 71, 90, 94, 710] {
            let late = format!("G1 Z-5 F100\nG{code} F100\nG1 Z-10");
            all_refused(2, "not_understood", "for the first time", &[&late]);
            let again = format!("G{code}\nG1 Z-5 F100\nG{code} F100\nG1 Z-10");
            assert_eq!(stretches(&again), [(5.0, 100.0), (10.0, 100.0)]);
        }
    }

    #[test]
    fn a_feed_is_forgotten_with_g94() {
        all_refused(3, "not_understood", "a cut without a feed", &["F100\nG94\nG1 Z-5"]);
        all_refused(4, "not_understood", "a cut without a feed", &["G94\nG1 Z-5 F100\nG94\nZ-10"]);
        // Above the work too: the control stops there.
        all_refused(1, "not_understood", "a cut without a feed", &["G1 Z1\nG1 Z-5 F100"]);
        assert_eq!(stretches("G1 F50\nG94 F100\nZ-5"), [(5.0, 100.0)]);
    }

    #[test]
    fn g99_may_be_a_feed_per_revolution() {
        all_refused(2, "not_understood", "per revolution", &["G99 G0 Z1\nG1 Z-5 F0.2"]);
        assert_eq!(stretches("G94 G99\nG1 Z-5 F100"), [(5.0, 100.0)]);
        assert_eq!(stretches("G99 G81 Z-5 R1 F100\nG80"), [(5.0, 100.0)]);
        assert_eq!(stretches("G99\nG98\nG1 Z-5 F100"), [(5.0, 100.0)]);
    }

    #[test]
    fn a_cycle_over_a_hole_that_was_begun_is_a_second_one() {
        let why = "holds a second hole";
        all_refused(2, "not_a_feed_over_depth", why, &["G1 Z-5 F100\nG81 Z-10 R1 F200"]);
        all_refused(2, "not_a_feed_over_depth", why, &["G81 Z-5 R1 F100\nZ-6"]);
    }

    #[test]
    fn a_line_hides_no_block() {
        all_refused(
            1,
            "not_understood",
            "carriage return",
            &["G1 Z-5 F100 ; x\rG1 Z-10\n", "(\r)G1 Z-5 F100"],
        );
        all_refused(1, "not_understood", "within a comment", &["(a (b) G1 Z-5 F100"]);
        assert_eq!(stretches("G1 Z-5 F100\r\nM30\r"), [(5.0, 100.0)]);
    }

    #[test]
    fn a_depth_has_the_digits_of_its_program() {
        assert_eq!(gcode("G1 Z-0.2 F100", 0.1).unwrap().held, [Held { to_mm: 0.3, feed_mm_min: 100.0 }]);
    }

    proptest! {
        /// A program is what its cuts are, whatever of the harmless stands between; one odd block in the hole and it is refused.
        #[test]
        fn a_program_is_its_cuts_or_nothing(
            cuts in prop::collection::vec((1_u32..5000, 1_u32..900_000, 0_usize..6), 1..12),
            odd in 0_usize..22, at in any::<prop::sample::Index>(),
        ) {
            let harmless = ["", "(A)\n", "M8\n", "S2800 M3\n", "G64 P0.01\n", "N7\n"];
            let odds = [
                "%", "M99", "M17", "M30", "G0 X10", "X1", "T2 M6", "G43 H2", "G54", "G49", "D2", "G0.96", "G-1", "R2", "G1 G1",
                "M3 M4", "M97 P1", "M98 P1", "M0", "M123", "O2", "F1 F2",
            ];
            let (mut blocks, mut held, mut depth) = (Vec::new(), Vec::new(), 0_u32);
            for &(way, feed, between) in &cuts {
                depth += way;
                let (to_mm, feed_mm_min) = (f64::from(depth) / 1000.0, f64::from(feed) / 1000.0);
                blocks.push(format!("{}G1 Z-{to_mm} F{feed_mm_min}\n", harmless[between]));
                held.push(Held { to_mm, feed_mm_min });
            }
            let (begin, end) = ("%\nO1\nG21 G90 G94\nG0 X1 Y2\nZ1\n", "G0 Z5\nM30\n%\n");
            let program = |blocks: &[String]| [begin, &blocks.concat(), end].concat();
            prop_assert_eq!(&gcode(&program(&blocks), 0.0).unwrap().held, &held);
            // Behind the first cut and before the way up, which is none where nothing is left to cut.
            let at = at.index(blocks.len()) + 1;
            blocks.insert(at, format!("{}\n", odds[odd]));
            blocks.push(format!("Z-{} F1\n", f64::from(depth + 1) / 1000.0));
            prop_assert!(gcode(&program(&blocks), 0.0).is_err(), "{}", program(&blocks));
        }
    }
}
