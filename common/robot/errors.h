// Room: common/robot. Errors a user can act on: they name file, key, value, unit and what is allowed. Host only.
#pragma once

#include <stdexcept>
#include <string>

namespace mrr {

/// A description (URDF, YAML, board, plan request) that cannot be used. `what()` is one sentence for the user.
class DescriptionError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A strike that cannot be planned (unreachable nail, infeasible speed, ...). `what()` is one sentence for the user.
class PlanError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace mrr
