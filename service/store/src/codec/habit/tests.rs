use super::super::column::{Column, Time};
use super::super::frame::decode_columns;
use super::super::frame::tests::cycle as cycle_of_every_field;
use super::super::guide::tests::drilled;
use super::super::{encode, encode_samples};
use super::*;
use feedwright_core::cycle::{Channel, CycleDraft};
use proptest::prelude::*;

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
        let known = columns.channels.iter().map(|(channel, column)| (*channel as u8, scale(column)));
        let by_habit = habit.suits(known);
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
        assert_eq!(habits.encode(&one), encode(&one));
    }
    assert!(kept(&one) && !kept(&other) && !kept(&of_machine("M1", "flange")));
    let without = one.clone().with_samples(None);
    assert_eq!(habits.encode(&without), encode(&without));
    for machine in 0..2 * PLACES {
        habits.encode(&of_machine(&format!("N{machine}"), "bush"));
    }
    let places = habits.places();
    assert_eq!(places.len(), PLACES);
    let used = places.iter().flatten().count();
    assert!(used > PLACES / 2, "{used} places are used");
}

fn any_column(len: usize) -> impl Strategy<Value = Column> {
    prop_oneof![
        (0_u8..4, prop::collection::vec(-1000_i64..1000, len))
            .prop_map(|(scale, values)| Column::Decimal { scale, values }),
        (0_u8..4, prop::collection::vec(-(1_i64 << 50)..1 << 50, len))
            .prop_map(|(scale, values)| Column::Decimal { scale, values }),
        (any::<i32>(), -50_i64..50).prop_map(move |(first, step)| {
            let values = (0..).map(|k| i64::from(first) + k * step).take(len).collect();
            Column::Decimal { scale: 0, values }
        }),
        prop::collection::vec(any::<u64>(), len).prop_map(Column::Exact),
    ]
}

prop_compose! {
    fn any_columns()(len in prop_oneof![1_usize..4, 30_usize..90])(
        channels in prop::collection::btree_map(prop::sample::select(Channel::ALL), any_column(len), 1..8),
        times in prop::option::of(any_column(len)),
        len in Just(len),
    ) -> Columns {
        let time = times.map_or(Time::Period(10.0_f64.to_bits()), Time::Stamps);
        Columns { len, time, channels: channels.into_iter().collect() }
    }
}

proptest! {
    /// Whatever was written before, and however unlike it is: a habit is made to be gone by wherever the channels let it.
    #[test]
    fn blocks_that_are_written_by_habit_come_back(blocks in prop::collection::vec(any_columns(), 2..5)) {
        let mut habit = Habit::default();
        for columns in &blocks {
            let block = frame::encode_by(columns, &mut habit);
            prop_assert_eq!(&decode_columns(&block, columns.len).unwrap(), columns);
            habit.stands = true;
        }
    }

    #[test]
    fn a_cycle_that_comes_again_has_the_same_samples_and_hash(seed in any::<u64>(), len in 20_i64..200) {
        let habits = Habits::default();
        let samples = drilled(len, seed).into_samples().unwrap();
        let cycle = cycle_of_every_field().with_samples(Some(samples.clone()));
        for _ in 0..4 {
            let EncodedCycle { hash, samples: block } = habits.encode(&cycle);
            prop_assert_eq!(hash, encode(&cycle).hash);
            let block = block.unwrap();
            prop_assert_eq!(super::super::decode_samples(&block, samples.len()).unwrap(), samples.clone());
            prop_assert!(block.len() <= encode_samples(&samples).len() + 16);
        }
    }
}
