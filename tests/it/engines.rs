//! Stories over HTTP, told on SQLite and on PostgreSQL: `on_both!(name, …)` makes a test per engine of each function.
//!
//! A story does not know which engine it is told on: whoever opens a database inside of it asks [`next_database`].

use crate::store::Given;
use std::cell::RefCell;
use std::future::Future;

tokio::task_local! {
    /// Databases that the story has opened on PostgreSQL.
    static OPENED: RefCell<Vec<Given>>;
}

macro_rules! on_both {
    ($($story:ident),* $(,)?) => {
        mod sqlite {
            $(
                #[tokio::test]
                async fn $story() {
                    super::$story().await;
                }
            )*
        }

        mod postgres {
            $(
                #[tokio::test]
                async fn $story() {
                    $crate::engines::on_postgres(super::$story()).await;
                }
            )*
        }
    };
}
pub(crate) use on_both;

/// Tells a story on PostgreSQL, and removes its databases afterwards. Without a server the story fails, unless a person
/// asked to leave it out.
pub(crate) async fn on_postgres(story: impl Future<Output = ()>) {
    if Given::server().is_none() {
        return;
    }
    OPENED
        .scope(RefCell::default(), async {
            story.await;
            let opened = OPENED.with(RefCell::take);
            assert!(!opened.is_empty(), "a story without a database says nothing of PostgreSQL");
            for given in opened {
                given.removed().await;
            }
        })
        .await;
}

/// Address of a fresh database, where the story is told on PostgreSQL.
pub(crate) async fn next_database() -> Option<String> {
    OPENED.try_with(|_| ()).ok()?;
    let given = Given::postgres().await?;
    let address = given.address();
    OPENED.with(|opened| opened.borrow_mut().push(given));
    Some(address)
}
