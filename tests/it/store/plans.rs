//! What PostgreSQL reads for lists that are asked for again and again. Its planner chooses by what it knows of values and tables; of a
//! statement that it plans once for all values, and of a table that is new to it, it knows little.

use super::given::{Given, at, engineer, machine};
use feedwright_core::units::Timestamp;
use feedwright_store::{
    CommonClock, CycleFilter, Page, PointColumns, PostgresOptions, PostgresStore, Precondition, Store,
};

/// Cycles of a page.
const PAGE: u32 = 25;
/// So often each question is asked: a connection plans a statement by its values five times, and then may for all values.
const TIMES: u32 = 8;
/// Blocks of the table and its indexes that one page may need: ways down two indexes, what its rows are in, and what the planner looks up
/// of the ends of indexes.
const MOST_BLOCKS: i64 = 40;

/// Of three machines one stands still since the others came. Each has a tool and an operation of its own.
const HISTORY: &str = "INSERT INTO cycles (machine_id, cycle_id, tool_id, operation_id, started_at_us, received_at_us, seq, content_hash,
         outcome, summary_version, sample_count, coverage, energy_scale, flags, quantities)
     SELECT m, 'cycle-' || n, m, m, (late + n * 30) * 1000000::BIGINT, (late + n * 30 + 3) * 1000000::BIGINT,
         n, decode(repeat('ab', 32), 'hex'), 'completed', 7, 0, 1.0, 1, 0, 0
     FROM generate_series(1, 20000) AS n, (VALUES ('OLD', 1767000000), ('A', 1768000000), ('B', 1768000001)) AS v (m, late)
     ORDER BY 6";
/// When all but the last thousand of what each of the later machines ran had begun.
const LATE: Timestamp = Timestamp::from_micros(1_768_570_000_000_000);

/// The cycles of a machine, an operation, a tool and all machines; `id` is that of each of them.
fn filters(id: &str) -> [CycleFilter; 4] {
    let all = CycleFilter::default();
    [
        CycleFilter { machine: Some(id.try_into().unwrap()), ..all.clone() },
        CycleFilter { operation: Some(id.try_into().unwrap()), ..all.clone() },
        CycleFilter { tool: Some(id.try_into().unwrap()), ..all.clone() },
        all,
    ]
}

#[derive(Debug, Clone, Copy)]
enum List {
    Cycles,
    Points,
    LastCycles,
    LastPoints,
    LastEnergies,
}

impl List {
    const ALL: [Self; 5] =
        [Self::Cycles, Self::Points, Self::LastCycles, Self::LastPoints, Self::LastEnergies];

    /// Asks for a page, and for the one behind it where there is one; says how many of them were full.
    async fn ask(self, store: &dyn Store, filter: &CycleFilter) -> u32 {
        let first = Page { after: None, limit: PAGE };
        let found = match self {
            Self::Cycles => {
                let page = store.cycles(filter, first).await.unwrap();
                let Some(last) = page.last().map(|last| &last.cycle) else { return 0 };
                let after = Some((last.started_at, last.machine.clone(), last.id.clone()));
                page.len() + store.cycles(filter, Page { after, limit: PAGE }).await.unwrap().len()
            }
            Self::Points => {
                let page = store.points(filter, first).await.unwrap();
                let Some(last) = page.last() else { return 0 };
                let after = Some(last.key.clone());
                page.len() + store.points(filter, Page { after, limit: PAGE }).await.unwrap().len()
            }
            Self::LastCycles => store.last_cycles(filter, PAGE).await.unwrap().len(),
            Self::LastPoints => store.last_points(filter, PointColumns::All, PAGE).await.unwrap().len(),
            Self::LastEnergies => store.last_points(filter, PointColumns::Energy, PAGE).await.unwrap().len(),
        };
        u32::try_from(found).unwrap() / PAGE
    }
}

/// Blocks that were read for each page, by one connection.
async fn blocks_of_a_page(given: &Given, list: List, filter: &CycleFilter) -> i64 {
    let before = given.blocks_of("cycles").await;
    let options =
        PostgresOptions { connections: 1, clock: CommonClock::Callers, ..PostgresOptions::default() };
    let store = PostgresStore::open(&given.address(), options).await.unwrap();
    let mut pages = 0;
    for _ in 0..TIMES {
        pages += list.ask(&store, filter).await.max(1);
    }
    store.close().await;
    (given.blocks_of("cycles").await - before) / i64::from(pages)
}

/// The same of a machine with its last cycles.
async fn blocks_of_a_row_of_the_fleet(given: &Given, id: &str) -> i64 {
    let before = given.blocks_of("cycles").await;
    let options =
        PostgresOptions { connections: 1, clock: CommonClock::Callers, ..PostgresOptions::default() };
    let store = PostgresStore::open(&given.address(), options).await.unwrap();
    store.put_machine(machine(id), Precondition::Unstated, &engineer(), at(0)).await.unwrap();
    for _ in 0..TIMES {
        let row = store.fleet_machine(&id.try_into().unwrap(), PAGE).await.unwrap().unwrap();
        assert_eq!(row.recent.len(), PAGE as usize);
    }
    store.close().await;
    (given.blocks_of("cycles").await - before) / i64::from(TIMES)
}

/// Holds each list to what a page of it needs.
async fn pages_are_read_alone(given: &Given, known: &str) {
    for (id, bounds) in
        [("OLD", &[(None, None)][..]), ("A", &[(None, None), (Some(LATE), None), (None, Some(LATE))])]
    {
        for filter in filters(id) {
            for (from, to) in bounds.iter().copied() {
                let filter = CycleFilter { from, to, ..filter.clone() };
                for list in List::ALL {
                    let blocks = blocks_of_a_page(given, list, &filter).await;
                    assert!(blocks <= MOST_BLOCKS, "{known}: {list:?} of {filter:?} reads {blocks} blocks");
                }
            }
        }
    }
}

#[tokio::test]
async fn a_page_reads_no_more_than_itself_however_often_it_is_asked_for() {
    let Some(given) = Given::postgres().await else {
        return;
    };
    assert_eq!(given.raw(HISTORY).await.unwrap(), 60_000);
    given.raw("ALTER TABLE cycles SET (autovacuum_enabled = false)").await.unwrap();
    pages_are_read_alone(&given, "nothing is known of the table").await;
    given.raw("ANALYZE cycles").await.unwrap();
    pages_are_read_alone(&given, "the table is known").await;
    let blocks = blocks_of_a_row_of_the_fleet(&given, "OLD").await;
    assert!(blocks <= MOST_BLOCKS, "a machine's row in the fleet reads {blocks} blocks");
    given.done().await;
}
