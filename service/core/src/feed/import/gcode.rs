//! One hole of a simple G-code program, as stretches of one feed each.

use super::{Held, at_line, bounded, number};
use crate::invalid::Violation;

/// What was read of a program beside its feeds, for a person to look at.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hole {
    /// Its stretches.
    pub held: Vec<Held>,
    /// Words that say nothing about the feed and were passed over, once each.
    pub passed_over: Vec<String>,
}

/// Where a program is while it is read.
struct Reader {
    contact_mm: f64,
    z: Option<f64>,
    feed: Option<f64>,
    /// Motion in force: 0, 1 or 81.
    motion: Option<u32>,
    retract: Option<f64>,
    done: bool,
    /// Whether the program's end (`M2`, `M30`) was read.
    ended: bool,
    hole: Hole,
}

/// One hole of a simple program: `G0`, `G1`, `G81`, `G80`, `G90`, `G94`, `G21`, `G71`, `G710`, `G17`, `F`, `Z`, `R`.
///
/// Comments in parentheses and behind a semicolon are passed over, as are X and Y of rapid moves, M, S, T, N, O and a lone
/// `%`, and what `G64` says of rounding. `contact_z_mm` is the Z of first contact. Pecking (`G73`, `G83`), dwells (`G4`, `G82`), feed per revolution
/// (`G95`), increments (`G91`), inches (`G20`, `G70`), variables, loops, calls and a second hole are refused: none of them
/// is a feed over depth.
///
/// # Errors
/// With the line and the word that is not understood.
pub fn gcode(text: &str, contact_z_mm: f64) -> Result<Hole, Vec<Violation>> {
    bounded(text)?;
    if !contact_z_mm.is_finite() {
        return Err(vec![Violation::new("contact_z_mm", "not_finite", "must be a finite number")]);
    }
    let mut reader = Reader {
        contact_mm: contact_z_mm,
        z: None,
        feed: None,
        motion: None,
        retract: None,
        done: false,
        ended: false,
        hole: Hole::default(),
    };
    // A byte order mark is how some editors begin.
    let text = text.trim_start_matches('\u{feff}');
    for (at, line) in text.lines().enumerate().map(|(at, line)| (at + 1, line)) {
        let words = words(line).map_err(|why| at_line(at, "not_understood", why))?;
        reader.line(&words).map_err(|(code, why)| at_line(at, code, why))?;
    }
    if reader.hole.held.is_empty() {
        return Err(vec![Violation::new("text", "too_few", "holds no move below first contact")]);
    }
    Ok(reader.hole)
}

type Word = (char, f64);

fn words(line: &str) -> Result<Vec<Word>, String> {
    let mut words = Vec::new();
    let line = line.split(';').next().unwrap_or_default().trim().to_ascii_uppercase();
    if line == "%" {
        return Ok(words);
    }
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            ' ' | '\t' | '\r' => {}
            '(' => {
                if !letters.by_ref().any(|letter| letter == ')') {
                    return Err("a comment does not end in its line".to_owned());
                }
            }
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
                words.push((letter, value));
            }
            '#' | '[' | ']' | '=' => return Err("variables and expressions are not read".to_owned()),
            other => return Err(format!("`{}` is not understood", other.escape_default())),
        }
    }
    Ok(words)
}

impl Reader {
    fn line(&mut self, words: &[Word]) -> Result<(), (&'static str, String)> {
        let refused = |why: &str| Err(("not_a_feed_over_depth", why.to_owned()));
        if self.ended && !words.is_empty() {
            return refused("holds blocks behind the program's end (M2, M30): give one program alone");
        }
        // Of two words one would be passed over, and nobody could say which.
        for (at, (letter, _)) in words.iter().enumerate() {
            if matches!(letter, 'Z' | 'F' | 'R') && words[..at].iter().any(|(before, _)| before == letter) {
                return Err(("not_understood", format!("the word {letter} stands twice in the block")));
            }
        }
        // What G64's P and Q bound is how far corners are rounded: a hole has none.
        let rounds = words.iter().any(|&(letter, value)| letter == 'G' && (value - 64.0).abs() < 0.05);
        let (mut z, mut sideways) = (None, false);
        let (mut motion, mut moved) = (self.motion, false);
        for &(letter, value) in words {
            match letter {
                'G' => {
                    if let Some(code) = self.code(value)? {
                        if moved && motion != Some(code) {
                            return Err(("not_understood", "two motions in one block".to_owned()));
                        }
                        (motion, moved) = (Some(code), true);
                    }
                }
                'M' if (value - 98.0).abs() < 0.5 || (value - 198.0).abs() < 0.5 => {
                    return refused("calls are not followed: give the called program");
                }
                'Z' => z = Some(value),
                'F' if value > 0.0 => self.feed = Some(value),
                'F' => return Err(("out_of_range", "a feed must be above 0".to_owned())),
                'R' => self.retract = Some(value),
                'X' | 'Y' => sideways = true,
                'P' | 'Q' if !rounds => {
                    return refused(&format!(
                        "{letter}{value}: dwells, pecks and repeats are no feed over depth"
                    ));
                }
                'L' | 'K' => {
                    return refused(&format!("{letter}{value}: repeats are no feed over depth"));
                }
                'M' | 'S' | 'T' | 'N' | 'O' | 'H' | 'D' | 'P' | 'Q' => {
                    let word = format!("{letter}{value}");
                    if letter != 'N'
                        && !self.hole.passed_over.contains(&word)
                        && self.hole.passed_over.len() < 50
                    {
                        self.hole.passed_over.push(word);
                    }
                }
                other => return Err(("not_understood", format!("the word {other} is not read"))),
            }
        }
        self.motion = motion;
        let is = |value: f64, code: f64| (value - code).abs() < 0.5;
        self.ended |=
            words.iter().any(|&(letter, value)| letter == 'M' && (is(value, 2.0) || is(value, 30.0)));
        let Some(z) = z else {
            return if sideways && motion == Some(1) {
                refused("a cut sideways is no hole")
            } else if sideways && motion == Some(81) && !self.hole.held.is_empty() {
                refused("holds a second hole: give one alone")
            } else {
                Ok(())
            };
        };
        match motion {
            Some(1) if sideways => refused("a cut sideways is no hole"),
            Some(1) => self.cut(z),
            Some(81) => {
                let Some(retract) = self.retract else {
                    return refused("G81 needs its R: where the feed begins");
                };
                if retract < self.contact_mm {
                    return refused("R lies below first contact: the rapid would hit the work");
                }
                self.z = Some(retract);
                self.cut(z)?;
                self.done = true;
                self.z = Some(retract);
                Ok(())
            }
            Some(0) => {
                if z < self.contact_mm && self.z.is_none_or(|now| z < now) {
                    return refused("a rapid move goes below first contact");
                }
                self.done |= !self.hole.held.is_empty();
                self.z = Some(z);
                Ok(())
            }
            _ => Err(("not_understood", "Z without G0, G1 or G81 before it".to_owned())),
        }
    }

    /// A G word; `Some` where it sets the motion.
    fn code(&mut self, value: f64) -> Result<Option<u32>, (&'static str, String)> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturating; compared below"
        )]
        let code = (value * 10.0).round() as u32;
        match code {
            0 => Ok(Some(0)),
            10 => Ok(Some(1)),
            810 => Ok(Some(81)),
            800 => Ok(Some(0)),
            170 | 210 | 400 | 430 | 490 | 540 | 610 | 640 | 710 | 900 | 940 | 980 | 990 | 7100 => Ok(None),
            910 => Err(("not_a_feed_over_depth", "G91: depths have to be absolute".to_owned())),
            200 | 700 | 7000 => Err(("not_a_feed_over_depth", "inches: give it in mm".to_owned())),
            950 => Err(("not_a_feed_over_depth", "G95: the feed has to be per minute".to_owned())),
            40 | 820 => Err(("not_a_feed_over_depth", "a dwell is no feed over depth".to_owned())),
            730 | 830 => Err(("not_a_feed_over_depth", "pecking is no feed over depth".to_owned())),
            _ => Err(("not_understood", format!("G{value} is not read"))),
        }
    }

    fn cut(&mut self, z: f64) -> Result<(), (&'static str, String)> {
        let from = self.z.unwrap_or(self.contact_mm);
        let depth = self.contact_mm - z;
        self.z = Some(z);
        if z >= from || depth <= 0.0 {
            // A way up, or still above the work.
            self.done |= z > from && !self.hole.held.is_empty();
            return Ok(());
        }
        if self.done {
            return Err(("not_a_feed_over_depth", "holds a second hole: give one alone".to_owned()));
        }
        let feed_mm_min = self.feed.ok_or(("not_understood", "a cut without a feed".to_owned()))?;
        if self.hole.held.is_empty() && from < self.contact_mm {
            return Err(("not_understood", "the first cut begins below first contact".to_owned()));
        }
        self.hole.held.push(Held { to_mm: depth, feed_mm_min });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> (String, &'static str) {
        let wrong = gcode(text, 0.0).unwrap_err();
        (wrong[0].path.clone(), wrong[0].code)
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
}
