//! What can go wrong in a store.

/// A store's error. "Not found" is none: it is `Ok(None)`.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The database does not answer, or not in time: nothing was changed, try again.
    #[error("the database is not available")]
    Unavailable(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The connection broke while committing: whether it was kept has to be read back by key.
    #[error("the outcome of a commit is not known")]
    OutcomeUnknown(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The disk or the server refuses writes: stop acknowledging and exit; an fsync is never retried.
    #[error("the database does not take writes")]
    NotWritable(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The disk refuses a read, or gives what is no page of a database: nothing was changed, and what is stored may be there all the same.
    /// For a change it is as refused writes are.
    #[error("the database cannot be read from its disk")]
    NotReadable(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The row is refused by the database's own checks.
    #[error("the database refuses the row: {constraint}")]
    Refused {
        /// Name of the constraint.
        constraint: String,
    },
    /// What was read does not decode: damaged or of a newer version.
    #[error("stored data is damaged: {what}")]
    Damaged {
        /// What and where.
        what: String,
    },
    /// The version named in a precondition is not the one in force.
    #[error("another version is in force")]
    VersionMismatch {
        /// The version in force; 0 where there is none.
        current: u64,
    },
    /// A change needs the version that it is based on, and none was named.
    #[error("a version has to be named")]
    VersionRequired {
        /// The version in force.
        current: u64,
    },
    /// It contradicts what is in force.
    #[error("{why}")]
    Conflict {
        /// Stable code.
        code: &'static str,
        /// A sentence for a person.
        why: String,
    },
    /// A bounded table is full.
    #[error("{what} is full")]
    Full {
        /// Which.
        what: &'static str,
    },
    /// Anything else.
    #[error("database error")]
    Database(#[source] Box<dyn std::error::Error + Send + Sync>),
}

impl StoreError {
    /// Of tables that could not be brought up to this program's: those of a later one are said to be that.
    pub(crate) fn of_migration(error: sqlx::migrate::MigrateError) -> Self {
        match error {
            sqlx::migrate::MigrateError::VersionMissing(number) => Self::of_later_version(number),
            error => Self::Database(Box::new(error)),
        }
    }

    /// Of a database into which a copy or a restore broke off.
    pub(crate) fn of_unfinished_transfer() -> Self {
        let why = "a copy or a restore into this database broke off, and a part of it is missing: run it once more, which goes on where it \
                   was, or begin with an empty database";
        Self::NotWritable(why.into())
    }

    /// Of a database that a later program has written.
    fn of_later_version(migration: i64) -> Self {
        let what = "it was written by a later version of this program, or by another one";
        Self::Database(format!("{what}: its migration {migration} is not known here").into())
    }

    /// Refuses a database that has a migration which this program does not: though its tables are the same, what stands in them may
    /// mean something else, and no sum over it would tell.
    pub(crate) fn unless_known(applied: &[i64], known: &sqlx::migrate::Migrator) -> StoreResult<()> {
        let later = applied.iter().copied().find(|number| !known.version_exists(*number));
        later.map_or(Ok(()), |number| Err(Self::of_later_version(number)))
    }

    /// What the disk said where it is that which fails: after a change that ends with it nothing is acknowledged any more.
    pub fn of_the_disk(&self) -> Option<&(dyn std::error::Error + Send + Sync)> {
        match self {
            Self::NotWritable(source) | Self::NotReadable(source) => Some(&**source),
            _ => None,
        }
    }

    /// What is damaged, with the cycle that it was found in.
    #[must_use]
    pub fn of_cycle(self, machine: &str, cycle: &str) -> Self {
        match self {
            Self::Damaged { what } => Self::Damaged { what: format!("cycle {machine}/{cycle}: {what}") },
            other => other,
        }
    }
}

/// A store's result.
pub type StoreResult<T> = Result<T, StoreError>;
