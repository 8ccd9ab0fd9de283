#include "cli/doctor.h"

#include <fmt/format.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "can_protocol/socketcan/can_socket.h"
#include "cli/exit_status.h"
#include "cli/files.h"
#include "cli/robot_commands.h"
#include "cli/text.h"
#include "common/rpc/client.h"
#include "common/rpc/runtime_dir.h"

namespace mrr::cli {

namespace {

using rpc::Json;

enum class Finding { good, poor, bad };

class Findings {
 public:
  void add(Finding finding, const std::string& what) {
    const char* word = finding == Finding::good ? "ok" : finding == Finding::poor ? "poor" : "BAD";
    fmt::print("{}", wrapped(fmt::format("  {:<5} {}", word, what), 8));
    ++(finding == Finding::bad ? bad_ : finding == Finding::poor ? poor_ : good_);
  }
  [[nodiscard]] int bad() const noexcept { return bad_; }
  [[nodiscard]] int poor() const noexcept { return poor_; }

 private:
  int good_ = 0;
  int poor_ = 0;
  int bad_ = 0;
};

void look_at_bus(Findings& findings, const std::string& interface) {
  try {
    const can::CanSocket socket = can::CanSocket::open(interface);
    findings.add(Finding::good, fmt::format("bus: {} is there and up", interface));
  } catch (const can::CanError& error) {
    findings.add(Finding::bad, fmt::format("bus: {}", error.what()));
  }
}

void look_at_runtime_dir(Findings& findings) {
  try {
    findings.add(Finding::good, fmt::format("runtime folder: {}, for you alone", rpc::runtime_dir().string()));
  } catch (const rpc::ConnectionError& error) {
    findings.add(Finding::bad, fmt::format("runtime folder: {}", error.what()));
  }
}

void look_at_scheduling(Findings& findings) {
  const sched_param wanted{80};
  const sched_param usual{0};
  if (sched_setscheduler(0, SCHED_FIFO, &wanted) == 0) {
    sched_setscheduler(0, SCHED_OTHER, &usual);
    findings.add(Finding::good, "real-time scheduling: allowed");
  } else {
    findings.add(
        Finding::poor,
        fmt::format("real-time scheduling: {}; cycles will be late when the machine is busy. Add 'rtprio 90' for "
                    "your user in /etc/security/limits.conf, or LimitRTPRIO=90 in the unit file",
                    std::strerror(errno)));
  }
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  constexpr rlim_t kEnough = 256ULL * 1024 * 1024;
  if (limit.rlim_cur >= kEnough || geteuid() == 0) {
    findings.add(Finding::good, "locking memory: allowed");
  } else {
    findings.add(
        Finding::poor,
        fmt::format("locking memory: at most {} KiB; a page that must be fetched delays a cycle. Add 'memlock "
                    "unlimited' for your user in /etc/security/limits.conf, or LimitMEMLOCK=infinity in the unit "
                    "file",
                    limit.rlim_cur / 1024));
  }
  utsname kernel{};
  uname(&kernel);
  const bool real_time = std::string_view(kernel.version).find("PREEMPT_RT") != std::string_view::npos;
  findings.add(real_time ? Finding::good : Finding::poor,
               real_time ? fmt::format("kernel: {}, fully preemptible", kernel.release)
                         : fmt::format("kernel: {} is not a PREEMPT_RT kernel: well for simulation, not for a robot of "
                                       "metal. On Debian: apt-get install linux-image-rt-amd64",
                                       kernel.release));
  timespec resolution{};
  clock_getres(CLOCK_MONOTONIC, &resolution);
  if (resolution.tv_sec > 0 || resolution.tv_nsec > 1'000) {
    findings.add(Finding::bad, fmt::format("clock: steps of {} ns; the cycle needs 1000 ns or finer: a kernel with "
                                           "high-resolution timers",
                                           resolution.tv_nsec));
  }
}

void look_at_programs(Findings& findings, const std::string& socket, const std::string& plant_socket) {
  try {
    rpc::Client client(rpc::socket_path(socket, "supervisor.sock"), "mrr_supervisor");
    const Json hello = greet(client);
    const Json status = client.call("status");
    findings.add(Finding::good, fmt::format("supervisor: {} on {}, {}", hello.at("robot").value("name", "?"),
                                            hello.at("bus").value("interface", "?"), status.value("activity", "?")));
    const Json& clock = status.at("clock");
    if (clock.value("kind", "") == "realtime" && clock.at("late_us").is_object()) {
      const double worst_us = clock.at("late_us").value("p99", 0.0);
      const double period_us = clock.value("period_us", 1000.0);
      const long long missed = clock.value("missed", 0LL);
      const bool well = worst_us < 0.5 * period_us && 1000 * missed <= clock.value("cycles", 0LL);
      findings.add(
          well ? Finding::good : Finding::poor,
          fmt::format("cycle: of those made 99 % were late by at most {:.0f} us of {:.0f} us; {} of {} left out{}",
                      worst_us, period_us, missed, clock.value("cycles", 0LL) + missed,
                      well ? "" : "; see scheduling above, and end what else the machine does"));
    }
  } catch (const std::exception& error) {
    findings.add(Finding::poor, fmt::format("supervisor: {}", error.what()));
  }
  try {
    rpc::Client client(rpc::socket_path(plant_socket, "plant.sock"), "mrr_plant");
    findings.add(Finding::good, "plant: mrr_plant answers: the robot is emulated");
  } catch (const std::exception&) {
    findings.add(Finding::good, "plant: no mrr_plant here: the robot is of metal, or none is up");
  }
}

}  // namespace

void add_doctor_command(CLI::App& app, int& status) {
  struct Arguments {
    std::string bus = "vcan0";
    std::string socket;
    std::string plant_socket;
  };
  auto arguments = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("doctor", "Check what a robot needs of this machine, and say what to do");
  command->add_option("--bus", arguments->bus, "CAN interface")->type_name("IFACE")->capture_default_str();
  command->add_option("--socket", arguments->socket, "Socket of mrr_supervisor")->type_name("PATH");
  command->add_option("--plant-socket", arguments->plant_socket, "Socket of mrr_plant")->type_name("PATH");
  command->footer("Exit status 1 if something is BAD; what is poor works, less well.");
  command->callback([arguments, &status] {
    Findings findings;
    look_at_bus(findings, arguments->bus);
    look_at_runtime_dir(findings);
    look_at_scheduling(findings);
    try {
      findings.add(Finding::good, fmt::format("files: robots and tools are in {}", data_root().string()));
    } catch (const std::exception& error) {
      findings.add(Finding::bad, fmt::format("files: {}", error.what()));
    }
    look_at_programs(findings, arguments->socket, arguments->plant_socket);
    fmt::print("\n{} bad, {} poor\n", findings.bad(), findings.poor());
    status = findings.bad() > 0 ? kExitNotDone : kExitDone;
  });
}

}  // namespace mrr::cli
