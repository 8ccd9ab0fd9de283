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

/// `place`: `problem` and the full stop it lacks (a question keeps its mark); control characters become spaces.
[[nodiscard]] inline DescriptionError description_error(const std::string& place, const std::string& problem) {
  std::string sentence = place + ": " + problem;
  for (char& c : sentence) {
    if (static_cast<unsigned char>(c) < 0x20U) c = ' ';
  }
  if (sentence.back() != '?') sentence += '.';
  return DescriptionError(sentence);
}

}  // namespace mrr
