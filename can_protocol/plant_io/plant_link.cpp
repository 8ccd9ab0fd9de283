#include "can_protocol/plant_io/plant_link.h"

#include <array>

namespace mrr::plant_io {

namespace {

constexpr Duration kAnnouncePeriod = milliseconds(50);

can::CanSocket open(const std::string& interface, Participant self) {
  const std::array<can::CanFilter, 2> filters{can::CanFilter{kTickId}, can::CanFilter{kTickId + group_of(self)}};
  can::CanSocketOptions options;
  options.filters = std::span(filters).first(group_of(self) == 0 ? 1 : 2);
  options.fd = true;
  can::CanSocket socket = can::CanSocket::open(interface, options);
  socket.use_kernel_times(true);
  return socket;
}

/// A smaller key wins the wire: base identifier first, then standard before extended, then the rest.
std::uint64_t arbitration_key(const can::Frame& f) noexcept {
  if (!f.extended) return static_cast<std::uint64_t>(f.id) << 20U;
  return static_cast<std::uint64_t>(f.id >> 18U) << 20U | 1U << 19U | (f.id & 0x3FFFFU);
}

}  // namespace

std::span<const can::ReceivedFrame> TickInbox::take(Time limit, Time at, Time now) noexcept {
  taken_.clear();
  while (!waiting_.empty() && (waiting_.front().at <= limit || waiting_.front().at > now)) {
    // Insertion keeps the order of equal identifiers and needs no memory; a tick has few frames, nearly sorted.
    const std::uint64_t key = arbitration_key(waiting_.front().frame);
    (void)taken_.push_back({waiting_.front().frame, at});
    std::size_t i = taken_.size() - 1;
    for (; i > 0 && arbitration_key(taken_[i - 1].frame) > key; --i) std::swap(taken_[i], taken_[i - 1]);
    waiting_.pop();
  }
  return {taken_.data(), taken_.size()};
}

std::span<const can::ReceivedFrame> TickInbox::take_as_received(Time limit) noexcept {
  taken_.clear();
  for (; !waiting_.empty() && waiting_.front().at <= limit; waiting_.pop()) (void)taken_.push_back(waiting_.front());
  return {taken_.data(), taken_.size()};
}

void TickInbox::fill(can::CanSocket& robot, Time limit) noexcept {
  while (!reaches_beyond(limit) && kCapacity - waiting_.size() >= can::CanSocket::kBatch) {
    const std::span<const can::ReceivedFrame> frames = robot.receive();
    for (const can::ReceivedFrame& f : frames) (void)waiting_.push(f);
    if (frames.size() < can::CanSocket::kBatch) break;
  }
}

PlantLink::PlantLink(const std::string& interface, Participant self, std::uint32_t configuration_hash)
    : self_(self), configuration_hash_(configuration_hash), socket_(open(interface, self)) {}

void PlantLink::announce() noexcept {
  const Time now = can::monotonic_now();
  if (announced_.ns != 0 && now - announced_ < kAnnouncePeriod) return;
  announced_ = now;
  (void)socket_.send(encode(Announcement{self_, configuration_hash_}));
}

void PlantLink::take(const can::ReceivedFrame& received, std::optional<OwnTick>& out) noexcept {
  const std::optional<Tick> tick = decode_tick(received.frame);
  if (!tick) {
    ++statistics_.malformed;
    return;
  }
  if (self_ != kSupervisor && tick->group == group_of(self_)) {
    block_ = tick->blocks[self_ % kBlocksPerTick];
    block_number_ = tick->number;
  }
  if (tick->group != 0) return;
  const bool has_block = self_ == kSupervisor || block_number_ == tick->number;
  if ((tick->asked & bit_of(self_)) == 0 || !has_block) {
    joined_ = false;
    return;
  }
  if (out) ++statistics_.skipped;
  OwnTick own;
  own.lockstep = tick->lockstep;
  own.ending = tick->ending;
  own.number = tick->number;
  own.sensors = block_;
  own.arrived = received.at;
  if (tick->lockstep) {
    // A restarted plant begins at zero again; an own clock must not.
    constexpr Duration kRejoinStep = milliseconds(1);
    if (started_ && tick->now + clock_shift_ <= own_now_) clock_shift_ = own_now_ + kRejoinStep - tick->now;
    own.now = tick->now + clock_shift_;
    own.since_last = started_ ? own.now - own_now_ : Duration{};
    own_now_ = own.now;
  } else {
    instant_ = own.now = whole_instant(tick->now, instant_.ns != 0 ? instant_ : can::monotonic_now());
  }
  started_ = true;
  joined_ = true;
  ++statistics_.ticks;
  out = own;
}

std::optional<OwnTick> PlantLink::wait(Duration timeout) noexcept {
  std::optional<OwnTick> tick;
  Time deadline = joined_ || timeout.ns <= 0 ? Time{} : can::monotonic_now() + timeout;
  while (true) {
    if (!joined_) announce();
    const Duration slice = joined_ ? timeout : std::min(timeout, kAnnouncePeriod);
    std::span<const can::ReceivedFrame> frames = socket_.receive(slice);
    const bool more = frames.size() == can::CanSocket::kBatch;
    const bool silent = frames.empty();
    for (const can::ReceivedFrame& f : frames) take(f, tick);
    if (more) {
      for (frames = socket_.receive(); !frames.empty(); frames = socket_.receive()) {
        for (const can::ReceivedFrame& f : frames) take(f, tick);
      }
    }
    if (tick || timeout.ns <= 0) return tick;
    // The frame of our group comes before the go: only silence for as long as was asked for is one.
    if (deadline.ns == 0 && !silent) deadline = can::monotonic_now() + timeout;
    if (deadline.ns == 0 || can::monotonic_now() >= deadline) {
      // Silence: the plant may be another one when it speaks again.
      joined_ = false;
      return tick;
    }
  }
}

std::span<const can::ReceivedFrame> PlantLink::robot_frames(can::CanSocket& robot, const OwnTick& tick) noexcept {
  // The cut compares the kernel's stamps themselves: no conversion can put two frames in another order.
  robot.use_kernel_times(true);
  inbox_.fill(robot, tick.arrived);
  const Time now = inbox_.reaches_beyond(tick.arrived) ? can::kernel_now() : Time{INT64_MAX};
  return inbox_.take(tick.arrived, tick.now - tick.since_last, now);
}

void PlantLink::discard_up_to(can::CanSocket& robot, const OwnTick& tick) noexcept {
  while (!robot_frames(robot, tick).empty()) {
  }
}

void PlantLink::answer(const OwnTick& tick, const AnswerPayload& payload, bool leaving) noexcept {
  (void)socket_.send(encode(Answer{self_, tick.number, leaving, payload}));
  if (leaving) left_ = true;
}

void PlantLink::leave() noexcept {
  if (started_ && !left_) (void)socket_.send(encode(Answer{self_, 0, true, {}}));
  left_ = true;
}

void PlantLink::advance_clock(Time own_now) noexcept {
  own_now_ = std::max(own_now_, own_now);
  started_ = true;
}

void PlantLink::forget() noexcept {
  joined_ = false;
  inbox_.clear();
}

}  // namespace mrr::plant_io
