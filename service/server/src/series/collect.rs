//! Cycles into series, page by page: no more is kept than the bucket that is being filled.

use super::{GroupBy, MAX_BUCKETS, MAX_CELLS, MAX_CYCLES, Measure, SeriesKey, Value, basis, levels};
use crate::http::dto::time;
use crate::http::problem::Problem;
use feedwright_core::invalid::Violation;
use feedwright_core::series::{Buckets, Spread};
use feedwright_store::{CycleFilter, CycleKey, CyclePoint, LastPoints, Page, PointColumns, Store};
use std::collections::{BTreeMap, BTreeSet};

/// Rows that are read at a time: a short read, so that no snapshot is held for long.
const PAGE: u32 = 2_000;

/// A series with a place for every bucket.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bucketed {
    /// A spread per bucket; `None` where nothing was measured.
    pub buckets: Vec<Option<Spread>>,
    /// Values of the bucket that is being filled.
    filling: Vec<f64>,
    at: usize,
}

impl Bucketed {
    fn add(&mut self, bucket: usize, value: f64) {
        if bucket != self.at {
            self.settle();
            self.at = bucket;
        }
        self.filling.push(value);
    }

    fn settle(&mut self) {
        if let Some(place) = self.buckets.get_mut(self.at) {
            *place = Spread::of(&mut self.filling).or(*place);
        }
        self.filling.clear();
    }
}

/// Series by their keys.
pub type Series<T> = BTreeMap<SeriesKey, T>;

struct Collecting<'a> {
    measures: &'a [Measure],
    by: GroupBy,
    buckets: Buckets,
    series: Series<Bucketed>,
}

impl Collecting<'_> {
    fn add(&mut self, key: &SeriesKey, bucket: usize, value: f64) -> Result<(), Problem> {
        if !self.series.contains_key(key) {
            self.open(key.clone())?;
        }
        if let Some(series) = self.series.get_mut(key) {
            series.add(bucket, value);
        }
        Ok(())
    }

    fn open(&mut self, key: SeriesKey) -> Result<(), Problem> {
        if (self.series.len() + 1) * self.buckets.count() > MAX_CELLS {
            let message = format!(
                "the answer would have more than {MAX_CELLS} buckets in all its series: ask for wider buckets, a \
                 shorter range, or one machine, tool or operation"
            );
            return Err(Violation::new("bucket", "too_many_series", message).into());
        }
        let empty = Bucketed { buckets: vec![None; self.buckets.count()], ..Bucketed::default() };
        self.series.insert(key, empty);
        Ok(())
    }

    fn point(&mut self, point: &CyclePoint) -> Result<(), Problem> {
        let Some(bucket) = self.buckets.of(point.key.0) else { return Ok(()) };
        let group = self.by.of(point.key.1.as_str(), point.tool.as_str(), point.operation.as_str());
        for &measure in self.measures {
            if measure == Measure::Energy {
                for energy in &point.energy {
                    self.add(&SeriesKey::energy(energy, group), bucket, energy.total_joules)?;
                }
            } else if let Some(value) = measure.of(point) {
                self.add(&SeriesKey::plain(measure, group), bucket, value)?;
            }
        }
        Ok(())
    }
}

/// Widest bucket, a hundred years in µs: of wider ones the edges are no times any more.
const WIDEST_US: i64 = 36_525 * 86_400 * 1_000_000;

/// Checks that the buckets can be answered.
fn countable(buckets: Buckets, width_us: i64) -> Result<Buckets, Problem> {
    if width_us > WIDEST_US {
        let message = "must be at most 36525d, that is a hundred years";
        return Err(Violation::new("bucket", "out_of_range", message).into());
    }
    if buckets.count() <= MAX_BUCKETS {
        return Ok(buckets);
    }
    let message = format!(
        "the range has {} buckets of {} ms, may have at most {MAX_BUCKETS}",
        buckets.count(),
        width_us / 1_000
    );
    Err(Violation::new("bucket", "too_many_buckets", message).into())
}

/// The series of what the filter names, whose range is given, in buckets of that width. Says how many cycles it saw.
pub async fn bucketed(
    store: &dyn Store,
    filter: &CycleFilter,
    measures: &[Measure],
    by: GroupBy,
    width_us: i64,
) -> Result<(Buckets, Series<Bucketed>, usize), Problem> {
    let range = filter.from.zip(filter.to);
    let buckets = range.and_then(|(from, to)| Buckets::new(from, to, width_us));
    let buckets = buckets.ok_or_else(|| time::empty_range("to"))?;
    let buckets = countable(buckets, width_us)?;
    let mut collecting = Collecting { measures, by, buckets, series: Series::new() };
    // A series that is asked for by name is there even where nothing was measured: its gaps are the answer.
    let named = match by {
        GroupBy::Fleet => Some(""),
        GroupBy::Machine => filter.machine.as_ref().map(|id| id.as_str()),
        GroupBy::Tool => filter.tool.as_ref().map(|id| id.as_str()),
        GroupBy::Operation => filter.operation.as_ref().map(|id| id.as_str()),
    };
    for &measure in measures.iter().filter(|measure| **measure != Measure::Energy) {
        if let Some(group) = named {
            collecting.open(SeriesKey::plain(measure, group))?;
        }
    }
    let with_wear = measures.contains(&Measure::WearLevel);
    let (mut seen, mut after, mut tools) = (0, None, BTreeSet::new());
    loop {
        let page = store.points(filter, Page { after: after.take(), limit: PAGE }).await?;
        seen += page.len();
        if seen > MAX_CYCLES {
            let message = format!("the range holds more than {MAX_CYCLES} cycles: ask for a shorter one");
            return Err(Violation::new("from", "too_many_cycles", message).into());
        }
        for point in &page {
            collecting.point(point)?;
            if with_wear && !tools.contains(&point.tool) {
                tools.insert(point.tool.clone());
            }
        }
        match page.last() {
            Some(last) if page.len() == PAGE as usize => after = Some(last.key.clone()),
            _ => break,
        }
        // Between two pages others get their turn.
        tokio::task::yield_now().await;
    }
    if with_wear {
        let mut values = levels::of_tools(store, filter, &tools, by).await?;
        let bucket = |at| buckets.of(at).unwrap_or(usize::MAX);
        values.sort_by_key(|value| bucket(value.at));
        for levels::Level { group, at, level } in values {
            collecting.add(&SeriesKey::plain(Measure::WearLevel, &group), bucket(at), level)?;
        }
    }
    // So is energy, under no basis: which ones there would have been only cycles tell.
    if let Some(group) = named.filter(|_| measures.contains(&Measure::Energy))
        && collecting.series.keys().all(|key| key.measure != Measure::Energy)
    {
        collecting.open(SeriesKey::plain(Measure::Energy, group))?;
    }
    let mut series = collecting.series;
    series.values_mut().for_each(Bucketed::settle);
    Ok((buckets, series, seen))
}

/// The newest cycles of what was asked for, oldest first.
#[derive(Debug)]
pub struct LastCycles {
    points: LastPoints,
    levels: BTreeMap<CycleKey, f64>,
}

impl LastCycles {
    /// The newest `limit` of what the filter names.
    pub async fn of(
        store: &dyn Store,
        filter: &CycleFilter,
        measures: &[Measure],
        limit: u32,
    ) -> Result<Self, Problem> {
        let energy = measures.iter().all(|measure| matches!(measure, Measure::Energy | Measure::WearLevel));
        let told = if energy { PointColumns::Energy } else { PointColumns::All };
        let points = store.last_points(filter, told, limit).await?;
        let levels = match (measures.contains(&Measure::WearLevel), points.first(), points.last()) {
            (true, Some(first), Some(last)) => {
                let range = CycleFilter {
                    from: Some(first.key.0),
                    to: Some(feedwright_core::units::Timestamp::from_micros(
                        last.key.0.micros().saturating_add(1),
                    )),
                    ..filter.clone()
                };
                let tools: BTreeSet<_> = points.iter().map(|point| point.tool.clone()).collect();
                levels::by_cycle(store, &range, &tools).await?
            }
            _ => BTreeMap::new(),
        };
        Ok(Self { points, levels })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.points.len()
    }

    /// What they tell, cycle by cycle.
    pub fn series(&self, measures: &[Measure], by: GroupBy) -> Series<Vec<Value<'_>>> {
        let mut series = Found::default();
        for point in self.points.iter() {
            let group = by.of(point.key.1.as_str(), point.tool.as_str(), point.operation.as_str());
            let mut add = |measure: Measure, basis, value: f64| {
                series.values_of((measure, basis, group), self.points.len()).push(Value { point, value });
            };
            for &measure in measures {
                match measure {
                    Measure::Energy => {
                        for energy in &point.energy {
                            add(measure, Some(basis(energy)), energy.total_joules);
                        }
                    }
                    Measure::WearLevel => {
                        if let Some(level) = self.levels.get(&point.key) {
                            add(measure, None, *level);
                        }
                    }
                    plain => {
                        if let Some(value) = plain.of(point) {
                            add(measure, None, value);
                        }
                    }
                }
            }
        }
        let named = |((measure, basis, group), values): (Key<'_>, _)| {
            (SeriesKey { measure, basis, group: group.to_owned() }, values)
        };
        series.all.into_iter().map(named).collect()
    }
}

/// What tells series apart, borrowed.
type Key<'a> = (Measure, Option<(&'static str, &'static str)>, &'a str);

/// Series in the order in which they were met.
#[derive(Default)]
struct Found<'a> {
    all: Vec<(Key<'a>, Vec<Value<'a>>)>,
    places: BTreeMap<Key<'a>, usize>,
    last: usize,
}

impl<'a> Found<'a> {
    /// The values of that series, which is made for so many where it is new.
    fn values_of(&mut self, key: Key<'a>, most: usize) -> &mut Vec<Value<'a>> {
        // Most cycles tell the same in the same order as the one before.
        let next = if self.last + 1 < self.all.len() { self.last + 1 } else { 0 };
        self.last = match self.all.get(next) {
            Some((known, _)) if *known == key => next,
            _ => *self.places.entry(key).or_insert(self.all.len()),
        };
        if self.last == self.all.len() {
            // Of many groups none has all of them.
            let room = if self.all.is_empty() { most } else { 0 };
            self.all.push((key, Vec::with_capacity(room)));
        }
        &mut self.all[self.last].1
    }
}
