// Room: module_fw/actions. Who may have the joint: one table of every situation and request. The module asks it, the
// tests try all of it on a module, docs/arbiter.md prints it. Freestanding.
#pragma once

#include <array>
#include <cstdint>

#include "can_protocol/object_dictionary.h"

namespace mrr::fw {

/// What the joint is doing, as far as requests are concerned.
enum class Situation : std::uint8_t {
  disabled,        ///< not OPERATION ENABLED, or on the way out of it
  starting,        ///< enabled, the brake is not open yet
  motion,          ///< led by set points, or holding
  passive,         ///< the passive law has it
  homing,          ///< homing runs
  calibration,     ///< torque zero, brake test, limit recovery or identification runs
  user_stop,       ///< halt or quick stop
  limit,           ///< comes to rest for a limit or a source that fell silent
  fault_reaction,  ///< on its way to FAULT
  fault,
};
inline constexpr std::size_t kSituations = 10;
inline constexpr std::array<const char*, kSituations> kSituationNames{
    "disabled",    "starting",  "motion", "passive",        "homing",
    "calibration", "user_stop", "limit",  "fault_reaction", "fault"};

enum class Request : std::uint8_t {
  set_points,   ///< modes 8 and 10: to be led by them
  selection,    ///< active or passive, by RPDO4 or mode -1
  homing,       ///< mode 6 and controlword bit 4
  calibration,  ///< modes -2 to -5 and controlword bit 4
  halt,         ///< controlword bit 8
  quick_stop,   ///< controlword
  limit,        ///< a position limit or limit switch in the way
  disable,      ///< controlword
  fault,        ///< a fault with a reaction from `stop` on
  fault_reset,  ///< controlword bit 7
};
inline constexpr std::size_t kRequests = 10;
inline constexpr std::array<const char*, kRequests> kRequestNames{"set_points", "selection",  "homing", "calibration",
                                                                  "halt",       "quick_stop", "limit",  "disable",
                                                                  "fault",      "fault_reset"};

enum class Verdict : std::uint8_t {
  accepted,   ///< has effect; what goes on goes on
  pre_empts,  ///< has effect and ends what goes on
  waits,      ///< has effect once what goes on has ended
  refused,    ///< has no effect
};

/// Where a client reads why: nothing beyond the statusword, a limit code, or the cause that stands in error_or_limit.
enum class Shown : std::uint8_t { statusword, code, own_cause };

struct Rule {
  Verdict verdict = Verdict::refused;
  Shown shown = Shown::statusword;
  can::LimitCode code = can::LimitCode::none;
};

namespace arbiter {
inline constexpr Rule kYes{Verdict::accepted};
inline constexpr Rule kFirst{Verdict::pre_empts};
inline constexpr Rule kNo{Verdict::refused};
inline constexpr Rule kOwn{Verdict::refused, Shown::own_cause};
inline constexpr Rule kLater{Verdict::waits, Shown::own_cause};
constexpr Rule no(can::LimitCode code) { return {Verdict::refused, Shown::code, code}; }
constexpr Rule later(can::LimitCode code) { return {Verdict::waits, Shown::code, code}; }
}  // namespace arbiter

/// Priority: fault reaction > limit > user stop > calibration > homing > motion. What comes lower never pre-empts what
/// is higher; a mode asked for meanwhile waits.
inline constexpr std::array<std::array<Rule, kRequests>, kSituations> kArbiter = [] {
  using namespace arbiter;
  constexpr Rule kBrake = no(can::LimitCode::brake);
  constexpr Rule kHalt = no(can::LimitCode::halt);
  constexpr Rule kHoming = no(can::LimitCode::homing);
  constexpr Rule kCalibration = no(can::LimitCode::calibration);
  constexpr Rule kAfterHoming = later(can::LimitCode::homing);
  constexpr Rule kAfterCalibration = later(can::LimitCode::calibration);
  return std::array<std::array<Rule, kRequests>, kSituations>{{
      // set_points, selection, homing, calibration, halt, quick_stop, limit, disable, fault, fault_reset
      {kNo, kNo, kNo, kNo, kYes, kYes, kNo, kYes, kFirst, kNo},                          // disabled
      {kBrake, kBrake, kBrake, kBrake, kYes, kYes, kBrake, kFirst, kFirst, kNo},         // starting
      {kYes, kFirst, kFirst, kFirst, kFirst, kFirst, kFirst, kFirst, kFirst, kNo},       // motion
      {kNo, kFirst, kFirst, kFirst, kFirst, kFirst, kFirst, kFirst, kFirst, kNo},        // passive
      {kAfterHoming, kHoming, kYes, kFirst, kFirst, kFirst, kYes, kFirst, kFirst, kNo},  // homing
      {kAfterCalibration, kCalibration, kAfterCalibration, kCalibration, kFirst, kFirst, kFirst, kFirst, kFirst, kNo},
      {kHalt, kHalt, kHalt, kHalt, kYes, kYes, kFirst, kFirst, kFirst, kNo},  // user_stop
      {kOwn, kOwn, kLater, kLater, kLater, kYes, kYes, kFirst, kFirst, kNo},  // limit
      {kOwn, kOwn, kOwn, kOwn, kOwn, kOwn, kOwn, kOwn, kYes, kOwn},           // fault_reaction
      {kOwn, kOwn, kOwn, kOwn, kOwn, kOwn, kOwn, kOwn, kYes, kYes},           // fault
  }};
}();

constexpr const Rule& rule(Situation situation, Request request) noexcept {
  return kArbiter[static_cast<std::size_t>(situation)][static_cast<std::size_t>(request)];
}
constexpr bool permits(Situation situation, Request request) noexcept {
  const Verdict v = rule(situation, request).verdict;
  return v == Verdict::accepted || v == Verdict::pre_empts;
}

}  // namespace mrr::fw
