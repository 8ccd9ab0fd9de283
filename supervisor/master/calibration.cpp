#include "supervisor/master/calibration.h"

#include <span>

namespace mrr::sup {

namespace {

using can::ObjectId;

constexpr Duration kPollPeriod = milliseconds(250);
constexpr int kMaxRetries = 3;
constexpr std::uint8_t kDone = 2;  // of 2170h:01 and 2180h:01

struct Setting {
  ObjectId object;
  float CalibrationSettings::*value;
};
constexpr std::array kFrictionSettings{
    Setting{ObjectId::identification_travel_rad, &CalibrationSettings::travel_rad},
    Setting{ObjectId::identification_speed_rad_s, &CalibrationSettings::speed_rad_s},
};
constexpr std::array kTorqueZeroSettings{
    Setting{ObjectId::torque_zero_load_nm, &CalibrationSettings::load_nm},
};
constexpr std::array kBrakeSettings{
    Setting{ObjectId::brake_test_torque_nm, &CalibrationSettings::torque_nm},
};
constexpr std::array kFrictionResults{
    ObjectId::identification_state,
    ObjectId::identified_positive_1,
    ObjectId::identified_positive_2,
    ObjectId::identified_positive_3,
    ObjectId::identified_positive_4,
    ObjectId::identified_negative_1,
    ObjectId::identified_negative_2,
    ObjectId::identified_negative_3,
    ObjectId::identified_negative_4,
    ObjectId::identified_torque_constant_positive_nm_a,
    ObjectId::identified_torque_constant_negative_nm_a,
    ObjectId::identified_residual_nm,
    ObjectId::identified_samples,
};
constexpr std::array kTorqueZeroResults{ObjectId::action_state, ObjectId::torque_sensor_offset_nm};
constexpr std::array kBrakeResults{ObjectId::action_state, ObjectId::brake_test_slip_rad};

struct Kind {
  const char* name;
  std::int8_t mode;
  std::span<const Setting> settings;
  std::span<const ObjectId> results;
};
constexpr std::array<Kind, 3> kKinds{{
    {"friction", kModeIdentification, kFrictionSettings, kFrictionResults},
    {"torque-zero", kModeTorqueZero, kTorqueZeroSettings, kTorqueZeroResults},
    {"brake", kModeBrakeTest, kBrakeSettings, kBrakeResults},
}};
constexpr const Kind& of(CalibrationKind kind) { return kKinds[static_cast<std::size_t>(kind)]; }

}  // namespace

const char* describe(CalibrationKind kind) noexcept { return of(kind).name; }

const char* why_failed(const CalibrationReport& report) noexcept {
  if (report.settings.kind == CalibrationKind::friction) {
    switch (report.module_state) {
      case 3:
        return "there is not enough room to move to either side, or the joint does not know where it is";
      case 4:
        return "it was interrupted";
      case 5:
        return "the joint moved too little to fit friction to it, or a sensor was lost";
      case 6:
        return "the fit leaves too much unexplained";
      default:
        return "";
    }
  }
  switch (report.module_state) {
    case 3:
      return "it was not done in time";
    case 4:
      return "the joint moved too far";
    case 5:
      return report.settings.kind == CalibrationKind::torque_zero
                 ? "the offset is larger than torque_zero_max_nm allows"
                 : "it took too much torque";
    case 6:
      return "it was interrupted";
    case 7:
      return "the torque sensor is lost or its reading does not come to rest";
    case 8:
      return "the brake slipped";
    case 9:
      return "there is nothing to do";
    default:
      return "";
  }
}

void CalibrationRun::start(int joint, std::uint32_t command, const CalibrationSettings& settings, Time now) noexcept {
  report_ = {};
  report_.settings = settings;
  report_.joint = joint;
  report_.command = command;
  report_.state = ActionState::running;
  phase_ = Phase::settings;
  request_ = retries_ = 0;
  asked_ = false;
  last_poll_ = now;
}

void CalibrationRun::stop(NodeProxy& node) noexcept {
  if (!running()) return;
  node.stop_action();
  report_.state = ActionState::aborted;
}

void CalibrationRun::finish() noexcept {
  report_.has_result = true;
  report_.progress_percent = 100;
  report_.state = report_.module_state == kDone ? ActionState::attained : ActionState::failed;
}

void CalibrationRun::take(ObjectId object, const can::Value& value) noexcept {
  switch (object) {
    case ObjectId::identification_state:
    case ObjectId::action_state:
      report_.module_state = static_cast<std::uint8_t>(value.as_unsigned());
      return;
    case ObjectId::identification_progress_percent:
      report_.progress_percent = static_cast<std::uint8_t>(value.as_unsigned());
      return;
    case ObjectId::identified_samples:
      report_.points = static_cast<std::uint32_t>(value.as_unsigned());
      return;
    case ObjectId::identified_residual_nm:
      report_.residual_nm = value.as_real();
      return;
    case ObjectId::identified_torque_constant_positive_nm_a:
      report_.torque_constant_nm_a[0] = value.as_real();
      return;
    case ObjectId::identified_torque_constant_negative_nm_a:
      report_.torque_constant_nm_a[1] = value.as_real();
      return;
    case ObjectId::torque_sensor_offset_nm:
      report_.offset_nm = value.as_real();
      return;
    case ObjectId::brake_test_slip_rad:
      report_.slip_rad = value.as_real();
      return;
    default:
      break;
  }
  for (std::size_t k = 0; k < 8; ++k) {
    if (kFrictionResults[1 + k] == object) report_.friction[k / 4][k % 4] = value.as_real();
  }
}

void CalibrationRun::step(Time now, NodeProxy& node) noexcept {
  if (!running()) return;
  const Kind& kind = of(report_.settings.kind);
  can::SdoClient& sdo = node.sdo();
  if (phase_ == Phase::action && node.action() == ActionState::aborted) {
    report_.state = ActionState::aborted;
    return;
  }
  if (node.stage() != NodeStage::enabled) return stop(node);

  // What was asked for.
  if (asked_) {
    if (sdo.busy()) return;
    asked_ = false;
    if (sdo.status() == can::SdoClient::Status::done) {
      retries_ = 0;
      if (phase_ == Phase::results) take(kind.results[static_cast<std::size_t>(request_)], sdo.value());
      if (phase_ == Phase::action) take(ObjectId::identification_progress_percent, sdo.value());
      if (phase_ != Phase::action) ++request_;
    } else if (phase_ != Phase::action && (sdo.abort_code() != can::Abort::timeout || ++retries_ >= kMaxRetries)) {
      // The module does not know the object, or does not answer: nothing was found.
      node.stop_action();
      report_.state = ActionState::failed;
      return;
    }
  }

  switch (phase_) {
    case Phase::settings: {
      if (request_ == static_cast<int>(kind.settings.size())) {
        node.start_action(kind.mode);
        phase_ = Phase::action;
        return;
      }
      const Setting& setting = kind.settings[static_cast<std::size_t>(request_)];
      asked_ = sdo.download_real(setting.object, report_.settings.*setting.value);
      return;
    }
    case Phase::action:
      if (node.action() == ActionState::running) {
        const bool shows = report_.settings.kind == CalibrationKind::friction;
        if (!shows || now - last_poll_ < kPollPeriod) return;
        last_poll_ = now;
        asked_ = sdo.upload(ObjectId::identification_progress_percent);
        return;
      }
      phase_ = Phase::results;
      request_ = 0;
      [[fallthrough]];
    case Phase::results:
      if (request_ == static_cast<int>(kind.results.size())) return finish();
      asked_ = sdo.upload(kind.results[static_cast<std::size_t>(request_)]);
      return;
  }
}

}  // namespace mrr::sup
