use super::super::column::{Column, Time};
use super::super::frame::decode_columns;
use super::super::frame::tests::cycle as cycle_of_every_field;
use super::super::guide::tests::drilled;
use super::super::{encode, encode_samples};
use super::*;
use feedwright_core::cycle::{Channel, CycleDraft};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use std::cell::Cell;
use std::collections::BTreeMap;

/// The same channels as those of a drilled hole, each of which walks by itself.
fn walked(len: i64, seed: u64) -> Columns {
    let mut columns = drilled(len, seed);
    let mut state = seed;
    for (_, column) in &mut columns.channels {
        let Column::Decimal { values, .. } = column else { continue };
        let mut at = 0;
        for value in values {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            at += i64::try_from(state >> 54).unwrap() - 512;
            *value = at;
        }
    }
    columns
}

/// What is written of each with one habit, and whether by it.
fn written(blocks: impl IntoIterator<Item = Columns>, habit: &mut Habit) -> Vec<(usize, bool)> {
    let write = |columns: Columns| {
        let scale = |column: &Column| column.decimals().map(|(_, scale)| scale);
        let times = match &columns.time {
            Time::Period(_) => None,
            Time::Stamps(times) => Some((frame::TIMES, scale(times))),
        };
        let channels = columns.channels.iter().map(|(channel, column)| (*channel as u8, scale(column)));
        let by_habit = habit.suits(times.into_iter().chain(channels));
        let block = frame::encode_by(&columns, habit);
        assert_eq!(decode_columns(&block, columns.len).unwrap(), columns);
        (block.len(), by_habit)
    };
    blocks.into_iter().map(write).collect()
}

fn anew(columns: &Columns) -> usize {
    frame::encode_columns(columns).len()
}

#[test]
fn what_was_found_twice_is_gone_by_and_looked_for_again() {
    let blocks = || (0..60).map(|seed| drilled(380 + 10 * (seed % 5), u64::try_from(seed).unwrap()));
    let told = written(blocks(), &mut Habit::default());
    let by_habit: Vec<bool> = told.iter().map(|(_, by_habit)| *by_habit).collect();
    let again = 2 + usize::from(BY_HABIT);
    let first = [vec![false; 2], vec![true; again - 2], vec![false]].concat();
    assert_eq!(by_habit[..=again], first);
    // It may not be found again at once.
    assert!(by_habit[again + 1..].iter().filter(|by_habit| **by_habit).count() > 10, "{by_habit:?}");
    // Nothing is lost by it.
    let (with, without): (usize, usize) =
        (told.iter().map(|(bytes, _)| bytes).sum(), blocks().map(|columns| anew(&columns)).sum());
    assert!(with * 100 <= without * 101, "{with} instead of {without}");
}

#[test]
fn another_program_is_looked_at_from_its_second_block_on() {
    let mut habit = Habit::default();
    let before = written((0..4).map(|seed| drilled(400, seed)), &mut habit);
    assert!(before[3].1, "{before:?}");
    let told = written((0..12).map(|seed| walked(400, seed)), &mut habit);
    let by_habit: Vec<bool> = told.iter().map(|(_, by_habit)| *by_habit).collect();
    assert_eq!(by_habit[..3], [true, false, false]);
    assert!(by_habit[3..].contains(&true));
    assert_eq!(told[1].0, anew(&walked(400, 1)));
    // Those with other channels, and those with times, at once.
    let mut fewer = walked(400, 9);
    fewer.channels.pop();
    let mut timed = walked(400, 9);
    timed.time = Time::Stamps(Column::Decimal { scale: 0, values: (0..400).collect() });
    for other in [fewer, timed] {
        written((0..4).map(|seed| drilled(400, seed)), &mut habit);
        habit.stands = true;
        let expected = anew(&other);
        assert_eq!(frame::encode_by(&other, &mut habit).len(), expected);
    }
}

#[test]
fn programs_that_take_turns_have_no_habit() {
    let mut habit = Habit::default();
    written((0..3).map(|seed| drilled(400, seed)), &mut habit);
    let turns = (0..20).map(|seed| if seed % 2 == 0 { walked(400, seed) } else { drilled(400, seed) });
    let told = written(turns, &mut habit);
    assert!(told[1..].iter().all(|(_, by_habit)| !by_habit), "{told:?}");
}

fn of_machine(machine: &str, operation: &str) -> Cycle {
    let draft = CycleDraft {
        machine: machine.try_into().unwrap(),
        operation: operation.try_into().unwrap(),
        samples: Some(drilled(400, 7).into_samples().unwrap()),
        ..CycleDraft::clone(&cycle_of_every_field())
    };
    Cycle::new(draft).unwrap()
}

#[test]
fn each_machine_has_its_own_habit_and_there_are_only_so_many() {
    let habits = Habits::default();
    let kept = |cycle: &Cycle| {
        let of = key(cycle);
        let habit = habits.take(of);
        let stands = habit.as_ref().is_some_and(|habit| habit.stands);
        habits.keep(of, habit.unwrap_or_default());
        stands
    };
    let (one, other) = (of_machine("M1", "bush"), of_machine("M2", "bush"));
    for _ in 0..3 {
        assert_eq!(habits.encode(&one, Places::default()), encode(&one));
    }
    assert!(kept(&one) && !kept(&other) && !kept(&of_machine("M1", "flange")));
    let without = one.clone().with_samples(None);
    assert_eq!(habits.encode(&without, Places::default()), encode(&without));
    for machine in 0..2 * PLACES {
        habits.encode(&of_machine(&format!("N{machine}"), "bush"), Places::default());
    }
    let places = habits.places();
    assert_eq!(places.len(), PLACES);
    let used = places.iter().flatten().count();
    assert!(used > PLACES / 2, "{used} places are used");
}

/// What a column of a sequence of blocks is: its channel's code and scale stay, as a habit asks, and its values do not.
fn any_form() -> impl Strategy<Value = Option<u8>> {
    prop_oneof![5 => (0_u8..4).prop_map(Some), 1 => Just(None)]
}

/// Values as a control quantises them, some that are far off, the widest there are, and such as go straight on.
fn any_values(len: usize) -> impl Strategy<Value = Vec<i64>> {
    const WIDEST: i64 = (1 << 53) - 1;
    prop_oneof![
        prop::collection::vec(-1000_i64..1000, len),
        prop::collection::vec(prop_oneof![9 => -30_i64..30, 1 => -(1_i64 << 44) - 1..(1 << 44) + 2], len),
        prop::collection::vec(prop_oneof![Just(-WIDEST), Just(WIDEST), -5_i64..5], len),
        (any::<i32>(), -50_i64..50)
            .prop_map(move |(first, step)| (0..).map(|k| i64::from(first) + k * step).take(len).collect()),
    ]
}

fn any_column(len: usize, form: Option<u8>) -> BoxedStrategy<Column> {
    match form {
        Some(scale) => any_values(len).prop_map(move |values| Column::Decimal { scale, values }).boxed(),
        None => prop::collection::vec(any::<u64>(), len).prop_map(Column::Exact).boxed(),
    }
}

/// A block of those channels; of those of a drilled hole, some are as they were in one, where columns follow others.
fn any_block(channels: BTreeMap<Channel, Option<u8>>, has_times: bool) -> impl Strategy<Value = Columns> {
    let len = prop_oneof![1_usize..7, 30_usize..36, 60_usize..90, 255_usize..259];
    len.prop_flat_map(move |len| {
        let times = any_column(len, Some(0)).prop_map(move |times| has_times.then_some(times));
        let each: Vec<_> = channels
            .iter()
            .map(|(channel, form)| (Just(*channel), any_column(len, *form), any::<bool>()))
            .collect();
        (times, each, any::<u64>()).prop_map(move |(times, each, seed)| {
            let hole = drilled(i64::try_from(len).unwrap(), seed % 1000);
            let drilled = |channel: Channel| hole.channels.iter().find(|(of, _)| *of == channel);
            let channels = each.into_iter().map(|(channel, column, is_drilled)| {
                let scale = |column: &Column| column.decimals().map(|(_, scale)| scale);
                match drilled(channel).filter(|(_, of)| is_drilled && scale(of) == scale(&column)) {
                    Some((_, of)) => (channel, of.clone()),
                    None => (channel, column),
                }
            });
            let time = times.map_or(Time::Period(10.0_f64.to_bits()), Time::Stamps);
            Columns { len, time, channels: channels.collect() }
        })
    })
}

/// Blocks of one machine: each of the same channels, and unlike the others in everything else.
fn any_blocks() -> impl Strategy<Value = Vec<Columns>> {
    let of_hole = drilled(40, 1).channels.into_iter().map(|(channel, column)| {
        let scale = column.decimals().map(|(_, scale)| scale);
        (channel, scale)
    });
    let channels = prop_oneof![
        prop::collection::btree_map(prop::sample::select(Channel::ALL), any_form(), 1..8),
        Just(of_hole.collect::<BTreeMap<_, _>>()),
    ];
    (channels, any::<bool>())
        .prop_flat_map(|(channels, has_times)| prop::collection::vec(any_block(channels, has_times), 2..6))
}

/// Whatever was written before, and however unlike it is: a habit is made to be gone by.
#[test]
fn blocks_that_are_written_by_habit_come_back() {
    let by_habit = Cell::new(0);
    let mut runner = TestRunner::new(Config { source_file: Some(file!()), ..Config::default() });
    let told = runner.run(&any_blocks(), |blocks| {
        let mut habit = Habit::default();
        for columns in blocks {
            by_habit.set(by_habit.get() + usize::from(written([columns], &mut habit)[0].1));
            habit.stands = true;
        }
        Ok(())
    });
    told.unwrap();
    assert!(by_habit.get() > 200, "{} blocks went by habit", by_habit.get());
}

proptest! {
    #[test]
    fn a_cycle_that_comes_again_has_the_same_samples_and_hash(seed in any::<u64>(), len in 20_i64..200) {
        let habits = Habits::default();
        let samples = drilled(len, seed).into_samples().unwrap();
        let cycle = cycle_of_every_field().with_samples(Some(samples.clone()));
        for _ in 0..4 {
            let EncodedCycle { hash, samples: block } = habits.encode(&cycle, Places::default());
            prop_assert_eq!(hash, encode(&cycle).hash);
            let block = block.unwrap();
            prop_assert_eq!(super::super::decode_samples(&block, samples.len()).unwrap(), samples.clone());
            prop_assert!(block.len() <= encode_samples(&samples).len() + 16);
        }
    }
}
