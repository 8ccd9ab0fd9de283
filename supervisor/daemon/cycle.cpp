#include "supervisor/daemon/cycle.h"

namespace mrr::sup {

Cycle::Cycle(const RobotDescription& robot, const SupervisorConfig& config, BusPort& bus)
    : dof_(robot.dof()), supervisor_(robot, config), bus_(bus) {
  publish();
}

void Cycle::step(Time now, std::span<const can::ReceivedFrame> received) noexcept {
  now_ = now;
  Request request;
  Answer answer;
  const bool asked = mailbox_.take(request);
  if (asked) answer = handle(request);

  tx_.clear();
  supervisor_.step(now, received, tx_);
  if (!tx_.empty()) bus_.send({tx_.data(), tx_.size()});
  ++cycles_;
  if (recorded_swing_.load(std::memory_order_relaxed) > 0) add_row();
  publish();
  // After the state: who takes an event finds the state it speaks of.
  for (const Event& event : supervisor_.events()) {
    if (!events_.push(event)) ++dropped_events_;
  }
  supervisor_.events().clear();
  if (asked) mailbox_.reply(answer);
}

Answer Cycle::carry_out(const Request& request) noexcept {
  const Answer answer = handle(request);
  publish();
  return answer;
}

Answer Cycle::handle(const Request& request) noexcept {
  Answer answer;
  switch (request.kind) {
    case RequestKind::enable:
      supervisor_.enable(true);
      break;
    case RequestKind::disable:
      supervisor_.enable(false);
      break;
    case RequestKind::stop:
      supervisor_.stop();
      break;
    case RequestKind::reset:
      supervisor_.recover();
      break;
    case RequestKind::home:
      answer.refusal = supervisor_.home(request.joint);
      break;
    case RequestKind::move:
      answer.refusal = supervisor_.move(*request.motion);
      break;
    case RequestKind::passive:
      answer.refusal = supervisor_.set_passive(request.joint);
      break;
    case RequestKind::active:
      answer.refusal = supervisor_.set_active(request.joint);
      break;
    case RequestKind::calibrate:
      answer.refusal = supervisor_.calibrate(request.joint, request.calibration);
      break;
    case RequestKind::execute:
      answer.refusal = supervisor_.execute(*request.plan);
      break;
  }
  answer.command = supervisor_.command().number;
  return answer;
}

void Cycle::add_row() noexcept {
  RecordRow row;
  row.time_s = now_.seconds();
  row.swing = recorded_swing_.load(std::memory_order_relaxed);
  row.activity = supervisor_.activity();
  row.force_n = supervisor_.observer().force_n();
  const JointMotion& reference = supervisor_.reference();
  for (int i = 0; i < dof_; ++i) {
    const NodeMeasurement& measured = supervisor_.node(i).measured();
    row.joints[static_cast<std::size_t>(i)] = {reference.q[i],     measured.position_rad,
                                               reference.qd[i],    measured.velocity_rad_s,
                                               measured.torque_nm, measured.mode_display == -1};
  }
  if (!rows_.push(row)) dropped_rows_.fetch_add(1, std::memory_order_relaxed);
}

void Cycle::publish() noexcept {
  RobotState& state = state_.back();
  state.now = now_;
  state.cycles = cycles_;
  state.activity = supervisor_.activity();
  for (int i = 0; i < dof_; ++i) state.nodes[static_cast<std::size_t>(i)] = supervisor_.report(i);
  state.reference = supervisor_.reference();
  state.outcome = supervisor_.outcome();
  state.command = supervisor_.command();
  state.calibration = supervisor_.calibration();
  state.let_go = supervisor_.let_go();
  state.force_n = supervisor_.observer().force_n();
  state.bus = bus_.health();
  state.missed = missed_;
  state.dropped_events = dropped_events_ + supervisor_.dropped_events();
  state_.publish();
}

}  // namespace mrr::sup
