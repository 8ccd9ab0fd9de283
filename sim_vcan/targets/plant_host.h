// Room: sim_vcan/targets. The emulator as a process: the plant behind the plant bus, in lockstep or free-running, and
// what it tells on its control socket. Host only; may touch sim_vcan, can_protocol/plant_io, common/rpc.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "can_protocol/plant_io/plant_frames.h"
#include "can_protocol/socketcan/can_socket.h"
#include "common/rpc/server.h"
#include "module_fw/targets/linux/joint_bytes.h"
#include "module_fw/targets/linux/lateness.h"
#include "sim_vcan/plant/plant.h"
#include "sim_vcan/world/recorder.h"
#include "sim_vcan/world/swing_watch.h"
#include "sim_vcan/world/world.h"

namespace mrr::sim {

struct PlantHostOptions {
  std::string interface;  ///< the plant bus
  bool lockstep = true;
  std::uint64_t seed = 1;          ///< of noise and tolerances; 0: all nominal
  bool expect_supervisor = false;  ///< lockstep: ticks begin when it is there too
  std::int64_t ticks = 0;          ///< stop after this many; 0: go on
  bool verbose = false;
};

class PlantHost {
 public:
  /// The robot at its park position with the task's nail. Throws can::CanError, DescriptionError.
  PlantHost(const RobotDescription& robot, const PlantDescription& plant, const PlantHostOptions& options);

  /// Adds the methods of the control socket; the server must outlive run().
  void serve(rpc::Server& server);
  /// Ticks until `stop` is set or the ticks are used up.
  void run(const volatile int& stop);
  void print_statistics() const;

 private:
  struct Participant {
    bool expected = false;
    bool joined = false;
    bool answered = false;
    bool refused = false;  ///< said so
    std::uint32_t configuration_hash = 0;
    Time heard;  ///< CLOCK_MONOTONIC
    plant_io::AnswerPayload payload{};
  };
  static constexpr std::size_t kParticipants = plant_io::kSupervisor + 1U;

  void reset(double nail_height_m);
  void wait_for_participants(const volatile int& stop);
  void run_lockstep(const volatile int& stop);
  void run_realtime(const volatile int& stop);
  void send_tick(bool ending);
  void receive(Duration timeout);
  void take(const can::ReceivedFrame& received, Time now);
  void drop(plant_io::Participant who, const std::string& why);
  void apply_answers();
  /// Somebody who was asked has not answered the last tick.
  [[nodiscard]] bool unanswered() const;
  /// After each step: recording and the watch of the swing.
  void observe();
  [[nodiscard]] std::uint32_t joined() const;
  [[nodiscard]] std::uint32_t missing() const;
  [[nodiscard]] std::string names(std::uint32_t participants) const;
  void say(const std::string& sentence) const;

  [[nodiscard]] rpc::Json truth_json() const;
  [[nodiscard]] rpc::Json contacts_json(std::size_t from) const;
  [[nodiscard]] rpc::Json swings_json() const;
  [[nodiscard]] rpc::Json stop_recording(const std::string& path);

  RobotDescription robot_;
  PlantHostOptions options_;
  int dof_;
  Duration period_;
  Plant plant_;
  can::CanSocket socket_;
  rpc::Server* server_ = nullptr;
  std::array<Participant, kParticipants> participants_{};
  std::array<can::Frame, 6> frames_{};
  std::uint32_t number_ = 0;
  std::int64_t ticks_ = 0;
  Time now_;          ///< lockstep: simulated, goes on over a reset; free-running: CLOCK_MONOTONIC of the last tick
  Duration epoch_{};  ///< now_ = epoch_ + plant_.now()
  double wall_s_ = 0.0;
  std::int64_t malformed_ = 0;
  std::int64_t late_ = 0;  ///< free-running: ticks the world stood still because the process was late
  fw::Lateness late_by_;   ///< free-running

  std::unique_ptr<Telemetry> recording_;
  SwingWatch watch_;
  int swing_ = 0;
  std::vector<SwingTruth> swings_;
};

}  // namespace mrr::sim
