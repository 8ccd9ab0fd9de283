// Room: supervisor. What the robot planned and saw, as JSON: one form for result files and for the RPC interface.
// Host only, never in the cycle; may touch nlohmann-json.
#pragma once

#include <nlohmann/json.hpp>

#include "common/robot/robot.h"
#include "supervisor/ledger/ledger.h"
#include "supervisor/strike/session.h"

namespace mrr::sup {

/// Numbers that are not finite become null.
[[nodiscard]] nlohmann::ordered_json number(double value);
/// What a drawing of the arm needs: the chain, the face, the nail.
[[nodiscard]] nlohmann::ordered_json geometry_json(const RobotDescription& robot);
[[nodiscard]] const char* mode_name(PassiveMode mode) noexcept;
[[nodiscard]] const char* formulation_name(Formulation formulation) noexcept;
[[nodiscard]] nlohmann::ordered_json plan_json(const RobotDescription& robot, const StrikePlan& plan);
/// What the plan of a swing took for granted.
[[nodiscard]] nlohmann::ordered_json assumed_json(const SwingReport& swing);
/// What the joints felt of the blow.
[[nodiscard]] nlohmann::ordered_json seen_json(const SwingReport& swing);
/// null: the swing went through; else why not.
[[nodiscard]] nlohmann::ordered_json aborted_json(const SwingOutcome& outcome);
/// A swing as far as the robot itself knows it.
[[nodiscard]] nlohmann::ordered_json swing_json(const RobotDescription& robot, const SwingReport& swing);
/// What the gears have borne.
[[nodiscard]] nlohmann::ordered_json ledger_json(const RobotDescription& robot, const Ledger& ledger);

}  // namespace mrr::sup
