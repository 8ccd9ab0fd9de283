#include "supervisor/master/node_proxy.h"

#include <algorithm>
#include <array>

namespace mrr::sup {

namespace {

// Controlword and statusword patterns of CiA 402.
constexpr std::uint16_t kShutdown = 0x06;
constexpr std::uint16_t kSwitchOn = 0x07;
constexpr std::uint16_t kEnableOperation = 0x0F;
constexpr std::uint16_t kDisableVoltage = 0x00;
constexpr std::uint16_t kFaultReset = 0x80;
constexpr std::uint16_t kActionStart = 0x10;
constexpr std::uint16_t kActionAttained = 0x1000;
constexpr std::uint16_t kActionError = 0x2000;

enum class PowerState : std::uint8_t {
  not_ready,
  switch_on_disabled,
  ready,
  switched_on,
  enabled,
  quick_stop,
  reaction,
  fault
};

PowerState power_state(std::uint16_t statusword) noexcept {
  switch (statusword & 0x4FU) {
    case 0x40:
      return PowerState::switch_on_disabled;
    case 0x08:
      return PowerState::fault;
    case 0x0F:
      return PowerState::reaction;
    default:
      break;
  }
  switch (statusword & 0x6FU) {
    case 0x21:
      return PowerState::ready;
    case 0x23:
      return PowerState::switched_on;
    case 0x27:
      return PowerState::enabled;
    case 0x07:
      return PowerState::quick_stop;
    default:
      return PowerState::not_ready;
  }
}

constexpr Duration kProbePeriod = milliseconds(200);
constexpr Duration kCommandPeriod = milliseconds(20);  // a command PDO that has had no effect is repeated
constexpr Duration kEnableTimeout = milliseconds(2000);
constexpr std::int64_t kSilentCycles = 8;  // SYNC periods without a word from an enabled node
constexpr Duration kStartTimeout = milliseconds(1000);
constexpr Duration kRequestTimeout = milliseconds(100);
/// Several repetitions of the start bit, and several SYNCs: what the statusword says then is said of this action.
constexpr Duration kActionShows = milliseconds(200);
constexpr int kMaxRetries = 3;
constexpr int kMaxResets = 5;  // a fault that outlasts them needs another acknowledgement

/// Bring-up requests in order. 1019h may change only while 1006h is 0.
struct Request {
  can::ObjectId object;
  bool write;
};
constexpr std::array kRequests{
    Request{can::ObjectId::protocol_hash, false},
    Request{can::ObjectId::configuration_hash, false},
    Request{can::ObjectId::communication_cycle_period_us, true},  // 0
    Request{can::ObjectId::sync_counter_overflow, true},
    Request{can::ObjectId::communication_cycle_period_us, true},
    Request{can::ObjectId::producer_heartbeat_ms, true},
    Request{can::ObjectId::consumer_heartbeat_1, true},
};
constexpr int kIdentifyingRequests = 2;
constexpr int kClearPeriod = 2;

}  // namespace

const char* describe(NodeProblem problem) noexcept {
  switch (problem) {
    case NodeProblem::none:
      return "no problem";
    case NodeProblem::silent:
      return "nothing was heard of it";
    case NodeProblem::wrong_protocol:
      return "it speaks another version of the protocol";
    case NodeProblem::wrong_configuration:
      return "its configuration is not the one the robot was planned with";
    case NodeProblem::not_answering:
      return "it does not answer requests";
    case NodeProblem::request_refused:
      return "it refused a request";
    case NodeProblem::state_timeout:
      return "it did not reach the state asked for in time";
    case NodeProblem::fault:
      return "it reports a fault";
    case NodeProblem::heartbeat_lost:
      return "its heartbeat stopped";
  }
  return "?";
}

const char* describe(NodeStage stage) noexcept {
  switch (stage) {
    case NodeStage::absent:
      return "absent";
    case NodeStage::identifying:
      return "being identified";
    case NodeStage::configuring:
      return "being configured";
    case NodeStage::starting:
      return "starting";
    case NodeStage::idle:
      return "idle";
    case NodeStage::enabling:
      return "being enabled";
    case NodeStage::enabled:
      return "enabled";
    case NodeStage::refused:
      return "refused";
    case NodeStage::faulted:
      return "faulted";
    case NodeStage::lost:
      return "lost";
  }
  return "?";
}

NodeProxy::NodeProxy(const NodeSettings& settings) noexcept
    : settings_(settings), sdo_(settings.node_id, kRequestTimeout) {}

const char* describe_state(std::uint16_t statusword) noexcept {
  switch (power_state(statusword)) {
    case PowerState::not_ready:
      return "not ready to switch on";
    case PowerState::switch_on_disabled:
      return "switch on disabled";
    case PowerState::ready:
      return "ready to switch on";
    case PowerState::switched_on:
      return "switched on";
    case PowerState::enabled:
      return "operation enabled";
    case PowerState::quick_stop:
      return "quick stop active";
    case PowerState::reaction:
      return "fault reaction active";
    case PowerState::fault:
      return "fault";
  }
  return "?";
}

bool is_powered(std::uint16_t statusword) noexcept {
  switch (power_state(statusword)) {
    case PowerState::enabled:
    case PowerState::quick_stop:
    case PowerState::reaction:
      return true;
    case PowerState::not_ready:
    case PowerState::switch_on_disabled:
    case PowerState::ready:
    case PowerState::switched_on:
    case PowerState::fault:
      return false;
  }
  return false;
}

void NodeProxy::reset_fault() noexcept {
  if (stage_ == NodeStage::faulted) resets_left_ = kMaxResets;
  ask_again_ = stage_ == NodeStage::refused;
}

void NodeProxy::start_action(std::int8_t mode) noexcept {
  if (stage_ != NodeStage::enabled) return;
  action_ = ActionState::running;
  action_mode_ = mode;
  action_started_ = false;
}

void NodeProxy::stop_action() noexcept {
  if (action_ == ActionState::running) action_ = ActionState::aborted;
}

void NodeProxy::enter(NodeStage stage, Time now) noexcept {
  stage_ = stage;
  stage_since_ = now;
  last_command_ = now - kCommandPeriod;
  retries_ = 0;
}

void NodeProxy::refuse(NodeProblem problem, std::uint32_t detail, Time now) noexcept {
  problem_ = problem;
  problem_detail_ = detail;
  enter(NodeStage::refused, now);
}

void NodeProxy::receive(const can::ReceivedFrame& received) noexcept {
  const can::Frame& frame = received.frame;
  if (frame.extended || frame.remote) return;
  const std::uint8_t id = settings_.node_id;
  if (frame.id == can::kTpdo1CobId + id) {
    if (const auto pdo = can::unpack_tpdo1(frame)) {
      measured_.statusword = pdo->statusword;
      measured_.mode_display = pdo->modes_of_operation_display;
      measured_.position_rad = can::rad_from_urad(pdo->position_actual_urad);
      measured_.selection_acknowledged = pdo->selection_acknowledged;
      received_in_cycle_ |= 1U;
      received_ever_ |= 1U;
      last_heard_ = received.at;
    }
  } else if (frame.id == can::kTpdo2CobId + id) {
    if (const auto pdo = can::unpack_tpdo2(frame)) {
      measured_.velocity_rad_s = can::rad_s_from_urad_s(pdo->velocity_actual_urad_s);
      measured_.torque_nm = static_cast<double>(pdo->torque_actual_permille) * 1e-3 * settings_.rated_torque_nm;
      measured_.error_or_limit = pdo->error_or_limit;
      received_in_cycle_ |= 2U;
      received_ever_ |= 2U;
    }
  } else if (frame.id == can::kTpdo3CobId + id) {
    if (const auto pdo = can::unpack_tpdo3(frame)) {
      condition_.valid = true;
      condition_.winding_c = pdo->winding_temperature_ddegc * 0.1;
      condition_.drive_c = pdo->drive_temperature_degc;
      condition_.bus_v = pdo->bus_voltage_cv * 0.01;
      condition_.loop_load = pdo->loop_load_percent * 0.01;
    }
  } else if (frame.id == can::kSdoReplyCobId + id) {
    answer_ = frame;
    has_answer_ = true;
  } else if (const auto heartbeat = can::parse_heartbeat(frame); heartbeat && heartbeat->node_id == id) {
    heard_ = true;
    last_heard_ = received.at;
    nmt_state_ = heartbeat->state;
    if (heartbeat->state == can::NmtState::initialising) booted_ = true;
  } else if (const auto emergency = can::parse_emergency(frame); emergency && emergency->node_id == id) {
    if (emergency->code != 0) last_emergency_ = emergency->code;
  }
  measured_.valid = received_ever_ == 3U;
}

void NodeProxy::step(Time now, can::TransmitQueue& tx) noexcept {
  if (has_answer_) {
    has_answer_ = false;
    sdo_.handle(answer_, now, tx);
  }
  sdo_.tick(now, tx);

  // A node that boots has forgotten everything, whatever we thought of it.
  if (booted_) {
    booted_ = false;
    received_ever_ = 0;
    measured_ = NodeMeasurement{};
    condition_ = NodeCondition{};
    fault_ = 0;
    resets_left_ = 0;  // what is acknowledged is what there was
    sdo_.cancel();
    request_index_ = 0;
    request_pending_ = false;
    problem_ = NodeProblem::none;
    problem_detail_ = 0;
    enter(NodeStage::identifying, now);
  }
  // An enabled node answers every SYNC: its silence shows long before its heartbeat is overdue.
  Duration allowed = settings_.heartbeat_timeout;
  if (stage_ == NodeStage::enabled) allowed = std::min(allowed, settings_.sync_period * kSilentCycles);
  const bool silent = heard_ && now - last_heard_ > allowed;
  if (silent && stage_ != NodeStage::absent && stage_ != NodeStage::lost) {
    problem_ = NodeProblem::heartbeat_lost;
    heard_ = false;
    received_ever_ = 0;
    measured_.valid = false;
    condition_.valid = false;
    resets_left_ = 0;
    enter(NodeStage::lost, now);
  }
  if (stage_ != NodeStage::enabled) stop_action();

  switch (stage_) {
    case NodeStage::absent:
    case NodeStage::lost:
      if (heard_ && !silent) {
        request_index_ = 0;
        request_pending_ = false;
        problem_ = NodeProblem::none;
        enter(NodeStage::identifying, now);
      }
      break;
    case NodeStage::identifying:
    case NodeStage::configuring:
      step_requests(now, tx);
      break;
    case NodeStage::starting:
      if (nmt_state_ == can::NmtState::operational && measured_.valid) {
        problem_ = NodeProblem::none;
        enter(NodeStage::idle, now);
      } else if (now - stage_since_ > kStartTimeout) {
        refuse(NodeProblem::state_timeout, 0, now);
      } else if (now - last_command_ >= kProbePeriod) {
        last_command_ = now;
        (void)tx.push_back(can::nmt_frame(can::NmtCommand::start, settings_.node_id));
      }
      break;
    case NodeStage::idle:
    case NodeStage::enabling:
    case NodeStage::enabled:
    case NodeStage::faulted:
      step_power(now, tx);
      break;
    case NodeStage::refused:
      if (ask_again_) {
        request_index_ = 0;
        request_pending_ = false;
        problem_ = NodeProblem::none;
        problem_detail_ = 0;
        enter(NodeStage::identifying, now);
      }
      break;
  }
  ask_again_ = false;
}

void NodeProxy::step_requests(Time now, can::TransmitQueue& tx) noexcept {
  (void)tx;
  if (request_pending_ && !sdo_.busy()) {
    request_pending_ = false;
    if (sdo_.status() == can::SdoClient::Status::failed) {
      if (sdo_.abort_code() != can::Abort::timeout) {
        refuse(NodeProblem::request_refused, static_cast<std::uint32_t>(sdo_.abort_code()), now);
        return;
      }
      if (++retries_ >= kMaxRetries) {
        refuse(NodeProblem::not_answering, 0, now);
        return;
      }
    } else {
      retries_ = 0;
      const auto value = static_cast<std::uint32_t>(sdo_.value().as_unsigned());
      const can::ObjectId object = kRequests[static_cast<std::size_t>(request_index_)].object;
      if (object == can::ObjectId::protocol_hash && value != can::kProtocolHash) {
        refuse(NodeProblem::wrong_protocol, value, now);
        return;
      }
      if (object == can::ObjectId::configuration_hash && value != settings_.configuration_hash) {
        refuse(NodeProblem::wrong_configuration, value, now);
        return;
      }
      ++request_index_;
      if (request_index_ == kIdentifyingRequests) enter(NodeStage::configuring, now);
      if (request_index_ == static_cast<int>(kRequests.size())) {
        enter(NodeStage::starting, now);
        last_command_ = now - kProbePeriod;
        return;
      }
    }
  }
  if (request_pending_ || sdo_.busy()) return;
  const Request& request = kRequests[static_cast<std::size_t>(request_index_)];
  if (!request.write) {
    request_pending_ = sdo_.upload(request.object);
    return;
  }
  std::int64_t value = 0;
  if (request.object == can::ObjectId::communication_cycle_period_us && request_index_ != kClearPeriod) {
    value = settings_.sync_period.ns / 1000;
  } else if (request.object == can::ObjectId::sync_counter_overflow) {
    value = kSyncCounterOverflow;
  } else if (request.object == can::ObjectId::producer_heartbeat_ms) {
    value = settings_.heartbeat_period.ns / 1'000'000;
  } else if (request.object == can::ObjectId::consumer_heartbeat_1) {
    value = (static_cast<std::int64_t>(can::kSupervisorNodeId) << 16) | (settings_.heartbeat_timeout.ns / 1'000'000);
  }
  request_pending_ = sdo_.download_integer(request.object, value);
}

void NodeProxy::send_controlword(std::uint16_t controlword, Time now, can::TransmitQueue& tx,
                                 std::int8_t mode) noexcept {
  if (controlword == controlword_ && mode == mode_ && now - last_command_ < kCommandPeriod) return;
  controlword_ = controlword;
  mode_ = mode;
  last_command_ = now;
  (void)tx.push_back(can::pack_rpdo1(settings_.node_id, {controlword, mode}));
}

// The mode first, then the start bit. The module may still show how an earlier run ended: only after the start has
// shown (neither attained nor failed), or has long been asked for, does the statusword speak of this one.
void NodeProxy::step_action(Time now, can::TransmitQueue& tx) noexcept {
  if (action_ == ActionState::running && in_action_mode()) {
    const bool attained = (measured_.statusword & kActionAttained) != 0;
    const bool error = (measured_.statusword & kActionError) != 0;
    if (mode_ == action_mode_ && controlword_ == (kEnableOperation | kActionStart)) {
      if ((!attained && !error) || now - action_asked_ > kActionShows) action_started_ = true;
      if (action_started_ && (attained || error)) action_ = attained ? ActionState::attained : ActionState::failed;
    } else {
      action_asked_ = now;
    }
    if (action_ == ActionState::running) {
      send_controlword(kEnableOperation | kActionStart, now, tx, action_mode_);
      return;
    }
  }
  if (action_ == ActionState::running) {
    send_controlword(kEnableOperation, now, tx, action_mode_);
  } else if (in_action_mode()) {
    send_controlword(kEnableOperation, now, tx);
  }
}

void NodeProxy::step_power(Time now, can::TransmitQueue& tx) noexcept {
  const PowerState state = power_state(measured_.statusword);
  if (state == PowerState::fault || state == PowerState::reaction) {
    if (stage_ != NodeStage::faulted) {
      problem_ = NodeProblem::fault;
      problem_detail_ = measured_.error_or_limit >= 0x1000U ? measured_.error_or_limit : last_emergency_;
      fault_ = static_cast<std::uint16_t>(problem_detail_);
      fault_at_ = now;
      enter(NodeStage::faulted, now);
    }
    if (resets_left_ > 0 && state == PowerState::fault && now - last_command_ >= kCommandPeriod) {
      // The bit acts on its rising edge only; an edge may be lost on the wire.
      if (controlword_ == kFaultReset) {
        send_controlword(kDisableVoltage, now, tx);
      } else {
        --resets_left_;
        send_controlword(kFaultReset, now, tx);
      }
    }
    return;
  }
  if (stage_ == NodeStage::faulted) {
    resets_left_ = 0;
    fault_ = 0;
    problem_ = NodeProblem::none;
    problem_detail_ = 0;
    enter(NodeStage::idle, now);
  }
  if (!wanted_) {
    if (stage_ != NodeStage::idle) enter(NodeStage::idle, now);
    if (state == PowerState::enabled || state == PowerState::switched_on || state == PowerState::quick_stop) {
      send_controlword(kShutdown, now, tx);
    }
    return;
  }
  if (stage_ == NodeStage::idle) enter(NodeStage::enabling, now);
  switch (state) {
    case PowerState::switch_on_disabled:
      send_controlword(kShutdown, now, tx);
      break;
    case PowerState::ready:
      send_controlword(kSwitchOn, now, tx);
      break;
    case PowerState::switched_on:
      send_controlword(kEnableOperation, now, tx);
      break;
    case PowerState::quick_stop:
      send_controlword(kDisableVoltage, now, tx);
      break;
    case PowerState::enabled:
      // The mode shows once the brake has let go and the joint is under control.
      if (stage_ == NodeStage::enabling) {
        if (measured_.mode_display == kModeCyclicPosition) {
          problem_ = NodeProblem::none;
          enter(NodeStage::enabled, now);
        } else {
          send_controlword(kEnableOperation, now, tx);
        }
      } else {
        step_action(now, tx);
      }
      return;
    case PowerState::not_ready:
    case PowerState::reaction:
    case PowerState::fault:
      break;
  }
  if (stage_ == NodeStage::enabled) enter(NodeStage::enabling, now);
  if (now - stage_since_ > kEnableTimeout) problem_ = NodeProblem::state_timeout;
}

}  // namespace mrr::sup
