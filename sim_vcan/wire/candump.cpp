#include "sim_vcan/wire/candump.h"

#include <array>
#include <cstdio>
#include <ostream>

namespace mrr::sim {

namespace {

constexpr char kHex[] = "0123456789ABCDEF";

}  // namespace

void CandumpWriter::write(const can::Frame& frame, Time at) {
  std::array<char, 64 + 2 * can::kMaxPayload> line;
  const long long micro = at.ns / 1000;
  int used = std::snprintf(line.data(), line.size(), "(%010lld.%06lld) ", micro / 1'000'000, micro % 1'000'000);
  out_.write(line.data(), used);
  out_ << interface_;
  used = std::snprintf(line.data(), line.size(), frame.extended ? " %08X#" : " %03X#", static_cast<unsigned>(frame.id));
  auto end = static_cast<std::size_t>(used);
  if (frame.remote) {
    line[end++] = 'R';
    if (frame.length > 0) line[end++] = kHex[frame.length & 0xFU];
  } else {
    if (frame.fd) {
      line[end++] = '#';
      line[end++] = frame.bit_rate_switch ? '1' : '0';  // CANFD_BRS
    }
    for (std::size_t i = 0; i < frame.length; ++i) {
      line[end++] = kHex[frame.data[i] >> 4U];
      line[end++] = kHex[frame.data[i] & 0xFU];
    }
  }
  line[end++] = '\n';
  out_.write(line.data(), static_cast<std::streamsize>(end));
}

}  // namespace mrr::sim
