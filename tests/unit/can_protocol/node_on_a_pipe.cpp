// A bare node in wall-clock time, for tests/python/test_protocol_clients.py: frames come in on stdin and go out on
// stdout, one a line: id in hex, length, bytes in hex ("-" if none). Ends with its input.
// The application behind it is none: writable objects hold what is written, and modes are shown as they are asked for.

#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "can_protocol/node.h"

namespace {

using namespace mrr;
using namespace mrr::can;

struct Application : NodeApplication {
  explicit Application(ObjectDictionary& dictionary) : od(dictionary) {}
  void written(ObjectId id, WriteSource, Time) noexcept override {
    if (id == ObjectId::modes_of_operation) od.modes_of_operation_display = od.modes_of_operation;
  }
  Abort store(Time) noexcept override { return Abort::none; }
  Abort restore_defaults(Time) noexcept override { return Abort::none; }
  ObjectDictionary& od;
};

Time now() {
  return {std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
              .count()};
}

Frame parse(const std::string& line) {
  Frame f;
  unsigned id = 0;
  unsigned length = 0;
  char bytes[17] = "";
  if (std::sscanf(line.c_str(), "%x %u %16s", &id, &length, bytes) == 3 && length <= 8) {
    f.id = id;
    f.length = static_cast<std::uint8_t>(length);
    for (unsigned i = 0; i < length; ++i) {
      const char two[3] = {bytes[2 * i], bytes[2 * i + 1], 0};
      f.data[i] = static_cast<std::uint8_t>(std::strtoul(two, nullptr, 16));
    }
  }
  return f;
}

void print(const TransmitQueue& tx) {
  for (const Frame& f : tx) {
    std::printf("%X %u ", f.id, unsigned{f.length});
    for (std::size_t i = 0; i < f.length; ++i) std::printf("%02X", f.data[i]);
    std::printf("%s\n", f.length == 0 ? "-" : "");
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  ObjectDictionary od;
  Application application(od);
  Node node(od, {.node_id = static_cast<std::uint8_t>(argc > 1 ? std::atoi(argv[1]) : 2)}, application);
  std::string input;
  for (;;) {
    TransmitQueue tx;
    pollfd in{STDIN_FILENO, POLLIN, 0};
    if (poll(&in, 1, 1) > 0) {
      char buffer[4096];
      const ssize_t n = read(STDIN_FILENO, buffer, sizeof buffer);
      if (n <= 0) return 0;
      input.append(buffer, static_cast<std::size_t>(n));
      for (std::size_t end = input.find('\n'); end != std::string::npos; end = input.find('\n')) {
        node.handle({parse(input.substr(0, end)), now()}, tx);
        input.erase(0, end + 1);
      }
    }
    node.tick(now(), tx);
    print(tx);
  }
}
