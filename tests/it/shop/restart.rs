//! What was acknowledged is there after a restart, and goes on.

use super::{Shop, reported};
use serde_json::json;

crate::engines::on_both!(a_restart_loses_nothing_and_goes_on_to_the_bit,);

async fn a_restart_loses_nothing_and_goes_on_to_the_bit() {
    let shop = Shop::open().await;
    for number in 1..=7 {
        assert_eq!(shop.cycle("M1", &reported(number, 1000.0 + number as f64)).await.status, 201);
    }
    let before = shop.get("/v1/tools/T1/wear").await.text;
    let shop = shop.restart().await;
    assert_eq!(shop.get("/v1/tools/T1/wear").await.text, before);
    assert_eq!(shop.cycle("M1", &reported(7, 1007.0)).await.status, 200);
    assert_eq!(shop.cycle("M1", &reported(8, 1008.0)).await.body["wear"]["counted"], json!(8));
}
