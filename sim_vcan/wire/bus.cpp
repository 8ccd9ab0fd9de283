#include "sim_vcan/wire/bus.h"

#include <algorithm>
#include <stdexcept>

namespace mrr::sim {

namespace {

// Fault confinement, ISO 11898-1:2015 clause 12.1.4.
constexpr int kPassiveAbove = 127;
constexpr int kBusOffAbove = 255;
constexpr int kReceiveErrorsAfterGood = 119;  // the standard allows 119-127
constexpr int kTransmitErrorStep = 8;
// Error flag 6, its echo by the other nodes up to 6, delimiter 8. The longest, since nothing here decides the echo.
constexpr int kErrorFrameBits = 20;
constexpr int kSuspendBits = 8;           // extra pause of an error-passive sender
constexpr int kRecoveryBits = 128 * 11;   // recessive bits seen before a node leaves bus-off
constexpr int kBitsAfterAcknowledge = 8;  // acknowledge delimiter, end of frame

constexpr std::uint32_t bit(std::size_t port) noexcept { return 1U << port; }

}  // namespace

Bus::Bus(const BusConfig& config) : config_(config), by_id_(kExtendedSlot + 1), random_(config.seed) {
  if (config.ports < 1 || config.ports > kMaxPorts) throw std::invalid_argument("Bus: ports must be 1-32");
  if (config.queue_capacity < 1) throw std::invalid_argument("Bus: queue_capacity must be at least 1");
  if (config.bit_rates.nominal < 1 || config.bit_rates.data < 1) {
    throw std::invalid_argument("Bus: bit rates must be positive");
  }
  ports_.resize(static_cast<std::size_t>(config.ports));
  for (Port& port : ports_) port.ring.resize(static_cast<std::size_t>(config.queue_capacity));
}

Duration Bus::nominal_bits(std::int64_t bits) const noexcept {
  return can::WireBits{static_cast<int>(bits), 0}.time(config_.bit_rates);
}

bool Bus::send(int port_index, const can::Frame& frame, Time now) noexcept {
  now_ = std::max(now_, now);
  settle();
  Port& port = at(port_index);
  PortStatus& status = port.status;
  if (!status.connected || status.state == ErrorState::kBusOff || !can::well_formed(frame)) {
    ++status.refused;
    return false;
  }
  if (status.queued == config_.queue_capacity) {
    ++status.overflows;
    ++statistics_.overflows;
    return false;
  }
  const std::size_t tail = (port.head + static_cast<std::size_t>(status.queued)) % port.ring.size();
  port.ring[tail] = {frame, now_, can::arbitration_key(frame)};
  ++status.queued;
  return true;
}

/// Who sends next and when, were nothing more queued before then.
Bus::Start Bus::next_start() const noexcept {
  Start start;
  const auto ready_at = [this](const Port& port) {
    return std::max({port.ring[port.head].since, port.may_send_from, idle_from_});
  };
  for (const Port& port : ports_) {
    if (port.status.queued == 0) continue;
    const Time ready = ready_at(port);
    if (start.port < 0 || ready < start.at) {
      start.port = 0;
      start.at = ready;
    }
  }
  if (start.port < 0) return start;
  start.port = -1;
  std::uint64_t best = 0;
  for (int i = 0; i < config_.ports; ++i) {
    const Port& port = at(i);
    if (port.status.queued == 0 || ready_at(port) > start.at) continue;
    const std::uint64_t key = port.ring[port.head].key;
    if (start.port < 0 || key < best) {
      start.port = i;
      start.conflict = false;
      best = key;
    } else if (key == best) {
      start.conflict = true;
    }
  }
  return start;
}

std::optional<Time> Bus::next_event() const noexcept {
  if (sender_ >= 0) return ends_;
  const Start start = next_start();
  if (start.port < 0) return std::nullopt;
  const Port& port = at(start.port);
  return start.at + can::frame_time(port.ring[port.head].frame, config_.bit_rates);
}

bool Bus::run_until(Time until) noexcept {
  for (;;) {
    if (sender_ >= 0) {
      if (ends_ > until) break;
      now_ = std::max(now_, ends_);
      settle();
      if (finish()) return true;
      continue;
    }
    const Start start = next_start();
    if (start.port < 0 || start.at >= until) break;
    now_ = std::max(now_, start.at);
    settle();
    begin(start);
  }
  now_ = std::max(now_, until);
  settle();
  return false;
}

void Bus::begin(const Start& start) noexcept {
  const can::Frame& frame = head(start.port).frame;
  const can::WireBits bits = can::wire_bits(frame);
  sender_ = start.port;
  started_ = start.at;
  frame_bits_ = bits.total();
  ends_ = started_ + bits.time(config_.bit_rates);
  if (start.conflict) ++statistics_.identifier_conflicts;

  const bool injected = take_fault(WireFault::kCorrupt, frame).has_value();
  const bool disturbed = config_.error_probability > 0.0 && random_.uniform() < config_.error_probability;
  unacknowledged_ = listeners() == 0;
  failing_ = injected || disturbed || unacknowledged_;
  if (injected || disturbed) {
    const auto hit = static_cast<std::int64_t>(random_.below(static_cast<std::uint64_t>(frame_bits_)));
    ends_ = started_ + (ends_ - started_) * (hit + 1) / frame_bits_ + nominal_bits(kErrorFrameBits);
    unacknowledged_ = false;
  } else if (unacknowledged_) {
    ends_ += nominal_bits(kErrorFrameBits - kBitsAfterAcknowledge);
  }
}

/// The transmission on the wire is over. True: delivery_ holds a frame that arrived.
bool Bus::finish() noexcept {
  const int from = sender_;
  Port& sender = at(from);
  sender_ = -1;
  idle_from_ = ends_ + nominal_bits(can::kIntermissionBits);
  statistics_.busy += idle_from_ - std::max(started_, statistics_since_);

  if (failing_) {
    ++statistics_.error_frames;
    for (Port& port : ports_) {
      if (&port == &sender || !listening(port)) continue;
      port.status.receive_errors = std::min(port.status.receive_errors + 1, kPassiveAbove + 1);
      update_state(port);
    }
    if (sender.status.connected) {
      // An error-passive node that hears no acknowledge does not count it, so a node alone never gets itself off the
      // bus.
      const bool counted = !(unacknowledged_ && sender.status.state == ErrorState::kPassive);
      if (counted) sender.status.transmit_errors += kTransmitErrorStep;
      update_state(sender);
      if (sender.status.state == ErrorState::kBusOff) discard(sender, 0);
      suspend_if_passive(sender);
    }
    return false;
  }

  const Queued& sent = head(from);
  delivery_.from = from;
  delivery_.frame = sent.frame;
  delivery_.at = ends_;
  delivery_.receivers = listeners(from);
  if (const auto fault = take_fault(WireFault::kDrop, sent.frame)) delivery_.receivers &= ~fault->receivers;
  for (std::size_t i = 0; i < ports_.size(); ++i) {
    Port& port = ports_[i];
    if (static_cast<int>(i) == from || !listening(port)) continue;
    PortStatus& status = port.status;
    if ((delivery_.receivers & bit(i)) != 0) ++status.received;
    if (status.receive_errors > kPassiveAbove) {
      status.receive_errors = kReceiveErrorsAfterGood;
    } else if (status.receive_errors > 0) {
      --status.receive_errors;
    }
    update_state(port);
  }

  const Duration delay = started_ - sent.since;
  IdStatistics& id = by_id_[sent.frame.extended ? kExtendedSlot : sent.frame.id];
  ++id.frames;
  id.bits += frame_bits_ + can::kIntermissionBits;
  id.worst_queue_delay = std::max(id.worst_queue_delay, delay);
  ++statistics_.frames;
  statistics_.worst_queue_delay = std::max(statistics_.worst_queue_delay, delay);
  ++sender.status.sent;
  if (sender.status.transmit_errors > 0) --sender.status.transmit_errors;
  update_state(sender);
  suspend_if_passive(sender);
  sender.head = (sender.head + 1) % sender.ring.size();
  --sender.status.queued;
  return true;
}

bool Bus::listening(const Port& port) noexcept {
  return port.status.connected && port.status.state != ErrorState::kBusOff;
}

std::uint32_t Bus::listeners(int except) const noexcept {
  std::uint32_t mask = 0;
  for (std::size_t i = 0; i < ports_.size(); ++i) {
    if (static_cast<int>(i) != except && listening(ports_[i])) mask |= bit(i);
  }
  return mask;
}

void Bus::update_state(Port& port) noexcept {
  PortStatus& status = port.status;
  if (status.state == ErrorState::kBusOff) return;  // only restart() leads out
  if (status.transmit_errors > kBusOffAbove) {
    status.state = ErrorState::kBusOff;
  } else if (status.transmit_errors > kPassiveAbove || status.receive_errors > kPassiveAbove) {
    status.state = ErrorState::kPassive;
  } else {
    status.state = ErrorState::kActive;
  }
}

void Bus::suspend_if_passive(Port& port) noexcept {
  if (port.status.state == ErrorState::kPassive) port.may_send_from = idle_from_ + nominal_bits(kSuspendBits);
}

/// Ports whose recovery from bus-off is over take part again.
void Bus::settle() noexcept {
  if (recovering_ == 0) return;
  for (Port& port : ports_) {
    if (!port.recovering || now_ < port.may_send_from) continue;
    port.recovering = false;
    --recovering_;
    port.status.state = ErrorState::kActive;
    port.status.transmit_errors = 0;
    port.status.receive_errors = 0;
  }
}

/// Keeps the oldest `keep` frames.
void Bus::discard(Port& port, int keep) noexcept {
  const int gone = std::max(port.status.queued - keep, 0);
  port.status.queued -= gone;
  port.status.discarded += gone;
}

void Bus::clear_queue(int port) noexcept { discard(at(port), sender_ == port ? 1 : 0); }

void Bus::connect(int port_index, bool connected) noexcept {
  Port& port = at(port_index);
  if (port.status.connected == connected) return;
  port.status.connected = connected;
  if (connected) {  // as after power-up
    port.status.state = ErrorState::kActive;
    port.status.transmit_errors = 0;
    port.status.receive_errors = 0;
    port.may_send_from = now_;
    return;
  }
  if (port.recovering) {
    port.recovering = false;
    --recovering_;
  }
  discard(port, 0);
  if (sender_ == port_index) {  // the frame breaks off; the others see a stuff error
    failing_ = true;
    unacknowledged_ = false;
    ends_ = std::max(now_, started_) + nominal_bits(kErrorFrameBits);
  }
}

void Bus::restart(int port_index, Time now) noexcept {
  now_ = std::max(now_, now);
  Port& port = at(port_index);
  if (!port.status.connected || port.status.state != ErrorState::kBusOff || port.recovering) return;
  port.recovering = true;
  ++recovering_;
  port.may_send_from = now_ + nominal_bits(kRecoveryBits);
}

bool Bus::inject(WireFault fault, std::uint32_t id, bool extended, int count, std::uint32_t receivers) noexcept {
  return faults_.push_back({fault, id, extended, count, receivers});
}

std::optional<Bus::PendingFault> Bus::take_fault(WireFault kind, const can::Frame& frame) noexcept {
  for (std::size_t i = 0; i < faults_.size(); ++i) {
    PendingFault& fault = faults_[i];
    if (fault.kind != kind || fault.id != frame.id || fault.extended != frame.extended || fault.count <= 0) continue;
    const PendingFault taken = fault;
    if (--fault.count == 0) {
      fault = faults_.back();
      faults_.truncate(faults_.size() - 1);
    }
    return taken;
  }
  return std::nullopt;
}

BusStatistics Bus::statistics() const noexcept {
  BusStatistics result = statistics_;
  result.elapsed = now_ - statistics_since_;
  if (sender_ >= 0) {
    result.busy += now_ - std::max(started_, statistics_since_);
  } else if (idle_from_ > now_) {  // the intermission that still runs was counted whole
    result.busy -= idle_from_ - now_;
  }
  return result;
}

void Bus::reset_statistics() noexcept {
  statistics_ = {};
  statistics_since_ = now_;
  if (sender_ < 0 && idle_from_ > now_) statistics_.busy = idle_from_ - now_;
  std::fill(by_id_.begin(), by_id_.end(), IdStatistics{});
}

}  // namespace mrr::sim
