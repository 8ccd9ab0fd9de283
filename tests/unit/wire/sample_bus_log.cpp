// Prints random frames with times for tests/python/test_bus_log.py: `log` in candump's format, `fields` as plain
// columns (microseconds, id, extended, remote, fd, bit rate switch, length, data or -, bits at nominal rate, bits at
// data rate).

#include <cstdio>
#include <cstring>
#include <iostream>

#include "can_protocol/bit_timing.h"
#include "sim_vcan/wire/candump.h"
#include "tests/unit/wire/random_frame.h"

int main(int argc, char** argv) {
  const bool fields = argc == 2 && std::strcmp(argv[1], "fields") == 0;
  if (!fields && !(argc == 2 && std::strcmp(argv[1], "log") == 0)) {
    std::fputs("usage: mrr_sample_bus_log log|fields\n", stderr);
    return 2;
  }
  mrr::Random random(2024);
  mrr::sim::CandumpWriter writer(std::cout, "vcan0");
  mrr::Time now;
  for (int i = 0; i < 2000; ++i) {
    now += mrr::microseconds(static_cast<std::int64_t>(random.below(5'000)));
    const mrr::can::Frame frame = mrr::test::random_frame(random);
    if (!fields) {
      writer.write(frame, now);
      continue;
    }
    std::printf("%lld %u %d %d %d %d %d ", static_cast<long long>(now.ns / 1000), static_cast<unsigned>(frame.id),
                frame.extended, frame.remote, frame.fd, frame.bit_rate_switch, frame.length);
    for (int k = 0; k < frame.length && !frame.remote; ++k)
      std::printf("%02x", frame.data[static_cast<std::size_t>(k)]);
    const mrr::can::WireBits bits = mrr::can::wire_bits(frame);
    std::printf("%s %d %d\n", frame.remote || frame.length == 0 ? "-" : "", bits.nominal, bits.data);
  }
  return 0;
}
