//! How often an address failed to authenticate.

use governor::clock::{Clock, DefaultClock};
use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter};
use std::net::{IpAddr, Ipv6Addr};
use std::num::NonZeroU32;
use std::time::Duration;

/// Most addresses kept apart; beyond them, unknown addresses share one allowance.
const MOST_ADDRESSES: usize = 10_000;

/// Counts failures by address. Who presents a good token is never slowed down by a neighbour who does not.
pub(crate) struct FailedAuthentications {
    limiter: DefaultKeyedRateLimiter<IpAddr>,
    clock: DefaultClock,
}

impl FailedAuthentications {
    pub(crate) fn new(per_minute: u32) -> Self {
        let quota = Quota::per_minute(NonZeroU32::new(per_minute).unwrap_or(NonZeroU32::MIN));
        Self { limiter: RateLimiter::hashmap(quota), clock: DefaultClock::default() }
    }

    /// Counts one failure; says how long to wait where there were too many.
    pub(crate) fn count(&self, peer: Option<IpAddr>) -> Option<Duration> {
        if self.limiter.len() >= MOST_ADDRESSES {
            self.limiter.retain_recent();
        }
        let unknown = IpAddr::V6(Ipv6Addr::UNSPECIFIED);
        let crowded = self.limiter.len() >= MOST_ADDRESSES;
        let key = peer.filter(|_| !crowded).map_or(unknown, network);
        let refused = self.limiter.check_key(&key).err()?;
        Some(refused.wait_time_from(self.clock.now()))
    }
}

/// The address, or its /64 for IPv6, where one customer has 2^64 of them.
fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => IpAddr::V4(address),
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX))),
    }
}
