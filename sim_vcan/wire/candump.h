// Room: sim_vcan/wire. Writes frames in can-utils' log format, which log2asc, canplayer, python-can and SavvyCAN read.
// Host only; uses can_protocol and an std::ostream that the caller owns.
#pragma once

#include <iosfwd>
#include <string>
#include <utility>

#include "can_protocol/frame.h"
#include "common/core/time.h"

namespace mrr::sim {

/// One line per frame: `(seconds.micro) interface ID#DATA`, remote `ID#R[length]`, FD `ID##flagsDATA`.
class CandumpWriter {
 public:
  /// `out` must outlive the writer; `interface` without blanks.
  CandumpWriter(std::ostream& out, std::string interface) : out_(out), interface_(std::move(interface)) {}

  /// `at` >= 0, written in microseconds, rounded down.
  void write(const can::Frame& frame, Time at);

 private:
  std::ostream& out_;
  std::string interface_;
};

}  // namespace mrr::sim
