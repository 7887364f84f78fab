//! The way of messages.

use super::random::{Random, normal, random_stream};
use super::window::{Window, holding};
use rand::RngExt;
use realnet_core::Stamp;
use std::collections::VecDeque;

/// How long messages take: normally distributed, cut at three deviations and at 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Latency {
    /// In the mean, s.
    pub mean_s: f64,
    /// Standard deviation, s.
    pub jitter_s: f64,
}

/// What goes wrong on the way for a while. What holds at a message's stamp befalls
/// it, all that hold at once together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ChannelFault {
    /// This share of the messages is lost, 0 to 1.
    Loss(f64),
    /// This share of the messages arrives twice, 0 to 1.
    Duplication(f64),
    /// Messages take so many seconds longer.
    Delay(f64),
    /// Each message takes 0 to so many seconds longer, evenly distributed, and may
    /// be overtaken by later ones.
    Scatter(f64),
}

/// How messages travel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChannelModel {
    /// How long they take.
    pub latency: Latency,
    /// Share that is lost, 0 to 1.
    pub loss: f64,
    /// Share that arrives twice, the second time after a latency of its own, 0 to 1.
    pub duplication: f64,
    /// What else goes wrong, and when.
    pub faults: Vec<Window<ChannelFault>>,
}

/// A message that arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct Delivered<T> {
    /// Exposure time of the frame that it is about: when it set out.
    pub stamp: Stamp,
    /// When it arrived.
    pub arrived: Stamp,
    /// What it says.
    pub value: T,
}

/// Messages on their way, in simulated time.
///
/// Messages arrive in the order of their sending, as on one connection, unless
/// [`ChannelFault::Scatter`] holds; second copies come when they come. Each message
/// takes the same count of random numbers, whatever becomes of it.
///
/// ```
/// use realnet_core::Stamp;
/// use realnet_sim::perception::{Channel, ChannelModel, Latency};
///
/// let latency = Latency { mean_s: 0.05, jitter_s: 0.0 };
/// let model = ChannelModel { latency, ..ChannelModel::default() };
/// let mut channel = Channel::new(model, 1, "words");
/// channel.send(Stamp::ZERO, "hello");
/// assert_eq!(channel.receive(Stamp::from_secs_f64(0.04)).count(), 0);
/// let arrived: Vec<_> = channel.receive(Stamp::from_secs_f64(0.06)).collect();
/// assert_eq!(arrived[0].value, "hello");
/// assert_eq!(arrived[0].arrived, Stamp::from_secs_f64(0.05));
/// ```
#[derive(Clone, Debug)]
pub struct Channel<T> {
    model: ChannelModel,
    random: Random,
    /// By time of arrival; those that arrive at once, as they were sent.
    on_the_way: VecDeque<Delivered<T>>,
    /// Arrival of the last message that kept the order.
    last_arrival: Stamp,
}

impl<T: Clone> Channel<T> {
    /// A way for messages, with the random numbers of `seed` and `name`.
    #[must_use]
    pub fn new(model: ChannelModel, seed: u64, name: &str) -> Self {
        Self {
            model,
            random: random_stream(seed, name),
            on_the_way: VecDeque::new(),
            last_arrival: Stamp::from_nanos(i64::MIN),
        }
    }

    /// Sends a message about the frame of a stamp.
    pub fn send(&mut self, stamp: Stamp, value: T) {
        let mut once = || (normal(&mut self.random), self.random.random::<f64>());
        let ways = [once(), once()];
        let (lot_of_loss, lot_of_copies): (f64, f64) = (self.random.random(), self.random.random());

        let (mut kept, mut single) = (1.0 - self.model.loss, 1.0 - self.model.duplication);
        let (mut delay, mut scatter) = (0.0, None);
        for fault in holding(&self.model.faults, stamp) {
            match *fault {
                ChannelFault::Loss(share) => kept *= 1.0 - share,
                ChannelFault::Duplication(share) => single *= 1.0 - share,
                ChannelFault::Delay(seconds) => delay += seconds,
                ChannelFault::Scatter(seconds) => scatter = Some(scatter.unwrap_or(0.0) + seconds),
            }
        }
        if lot_of_loss >= kept {
            return;
        }
        let Latency { mean_s, jitter_s } = self.model.latency;
        let arrivals = ways.map(|(deviate, lot)| {
            let travel = (mean_s + jitter_s * deviate.clamp(-3.0, 3.0)).max(0.0);
            let seconds = travel + delay + scatter.unwrap_or(0.0) * lot;
            stamp.seconds_later(seconds)
        });
        let [mut first, second] = arrivals;
        if scatter.is_none() {
            first = first.max(self.last_arrival);
            self.last_arrival = first;
        }
        if lot_of_copies >= single {
            self.insert(Delivered { stamp, arrived: second.max(first), value: value.clone() });
        }
        self.insert(Delivered { stamp, arrived: first, value });
    }

    fn insert(&mut self, message: Delivered<T>) {
        let place = self.on_the_way.partition_point(|other| other.arrived <= message.arrived);
        self.on_the_way.insert(place, message);
    }

    /// Takes the messages that have arrived by `now`, in the order of their arrival.
    pub fn receive(&mut self, now: Stamp) -> impl Iterator<Item = Delivered<T>> + '_ {
        std::iter::from_fn(move || self.on_the_way.pop_front_if(|message| message.arrived <= now))
    }

    /// When the next message arrives, of those that are on their way.
    #[must_use]
    pub fn next_arrival(&self) -> Option<Stamp> {
        self.on_the_way.front().map(|message| message.arrived)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn model(mean_s: f64, jitter_s: f64) -> ChannelModel {
        ChannelModel { latency: Latency { mean_s, jitter_s }, ..ChannelModel::default() }
    }

    /// Sends one message a frame at 100 Hz and receives after each.
    fn sent(model: ChannelModel, seed: u64, count: u64) -> Vec<Delivered<u64>> {
        let mut channel = Channel::new(model, seed, "test");
        let mut arrived = Vec::new();
        for index in 0..count {
            let now = Stamp::of_frame(index, 100.0);
            channel.send(now, index);
            arrived.extend(channel.receive(now));
        }
        arrived.extend(channel.receive(Stamp::from_nanos(i64::MAX)));
        arrived
    }

    #[test]
    fn everything_arrives_once_in_order_after_the_latency() {
        // the second time with jitter of twice the interval: without overtaking, a slow
        // message holds up the ones behind it
        for (jitter_s, latest) in [(0.002, 0.101), (0.02, 0.13)] {
            let arrived = sent(model(0.1, jitter_s), 3, 2000);
            let order: Vec<u64> = arrived.iter().map(|message| message.value).collect();
            assert_eq!(order, (0..2000).collect::<Vec<_>>());
            let taken = || arrived.iter().map(|m| m.arrived.seconds_since(m.stamp));
            // stamps are rounded to nanoseconds
            assert!(taken().all(|seconds| seconds >= 0.1 - 3.0 * jitter_s - 1e-8));
            let mean = taken().sum::<f64>() / 2000.0;
            assert!((0.099..latest).contains(&mean), "{mean}");
        }
    }

    #[test]
    fn loses_and_doubles_the_shares_it_is_told_to() {
        let mut lossy = model(0.01, 0.0);
        (lossy.loss, lossy.duplication) = (0.2, 0.1);
        let arrived = sent(lossy, 5, 20_000);
        let mut seen = vec![0; 20_000];
        arrived.iter().for_each(|message| seen[message.value as usize] += 1);
        let share = |n| seen.iter().filter(|count| **count == n).count() as f64 / 20_000.0;
        assert!((share(0) - 0.2).abs() < 0.01, "{}", share(0));
        assert!((share(2) - 0.08).abs() < 0.01, "{}", share(2));
        assert!(seen.iter().all(|count| *count <= 2));
    }

    #[test]
    fn faults_hold_in_their_window_alone_and_shift_nothing_outside() {
        let calm = model(0.05, 0.01);
        let mut faulty = calm.clone();
        faulty.faults = vec![
            Window::new(2.0, 4.0, ChannelFault::Loss(1.0)),
            Window::new(6.0, 8.0, ChannelFault::Scatter(0.2)),
        ];
        let (calm, faulty) = (sent(calm, 9, 1000), sent(faulty, 9, 1000));
        assert!(faulty.iter().all(|m| !(2.0..4.0).contains(&m.stamp.secs_f64())));
        assert_eq!(faulty.len(), 800);
        let scattered = faulty.iter().filter(|m| (6.0..8.0).contains(&m.stamp.secs_f64()));
        assert!(!scattered.is_sorted_by_key(|m| m.stamp));
        assert!(faulty.is_sorted_by_key(|m| m.arrived));
        for until in [2.0, 4.5, 9.0] {
            let outside = |m: &&Delivered<u64>| {
                let t = m.stamp.secs_f64();
                (until - 0.5..until).contains(&t) && !(2.0..4.0).contains(&t)
            };
            let both = [&calm, &faulty].map(|m| m.iter().filter(outside).collect::<Vec<_>>());
            assert_eq!(both[0], both[1]);
        }
    }

    proptest! {
        #[test]
        fn nothing_is_early_invented_or_out_of_order_of_arrival(
            seed in any::<u64>(), mean_s in 0.0..0.5f64, jitter_s in 0.0..0.2f64,
            loss in 0.0..1.0f64, duplication in 0.0..1.0f64, scatter in 0.0..0.5f64,
        ) {
            let mut model = model(mean_s, jitter_s);
            (model.loss, model.duplication) = (loss, duplication);
            model.faults = vec![Window::new(0.3, 0.8, ChannelFault::Scatter(scatter))];
            let arrived = sent(model.clone(), seed, 120);
            prop_assert!(arrived.is_sorted_by_key(|m| m.arrived));
            for message in &arrived {
                prop_assert_eq!(message.stamp, Stamp::of_frame(message.value, 100.0));
                prop_assert!(message.arrived >= message.stamp);
                let copies = arrived.iter().filter(|m| m.value == message.value).count();
                prop_assert!(copies <= 2);
            }
            prop_assert_eq!(arrived, sent(model, seed, 120));
        }
    }
}
