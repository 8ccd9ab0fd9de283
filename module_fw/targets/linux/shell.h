// Room: module_fw/targets/linux. The Linux shell around a module: CAN socket, plant bus, clock, signals. Host only;
// may touch module_fw, can_protocol/socketcan and plant_io.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "can_protocol/plant_io/plant_link.h"
#include "can_protocol/socketcan/can_socket.h"
#include "module_fw/module.h"
#include "module_fw/targets/host/file_store.h"
#include "module_fw/targets/linux/lateness.h"

namespace mrr::fw {

enum class Pace : std::uint8_t { as_plant, lockstep, realtime };

struct ShellOptions {
  std::string name;   ///< of the joint, for messages
  int number = 1;     ///< of the joint, from 1
  std::string can;    ///< the robot's bus
  std::string plant;  ///< the plant bus; empty: no hardware
  std::string store;  ///< file of stored parameters; empty: none
  Pace pace = Pace::as_plant;
  bool verbose = false;
};

class Shell {
 public:
  /// Opens what is needed. Throws can::CanError.
  Shell(const ModuleConfig& config, const ShellOptions& options);
  /// Ticks until `stop` is set, then stops the joint and returns.
  void run(const volatile int& stop);
  /// Ticks, lateness, losses, on standard error.
  void print_statistics() const;

 private:
  void wait_for_plant(const volatile int& stop);
  enum class Next : std::uint8_t { done, lockstep, clock };
  /// From `first_` on, until the joint has stopped or the plant is lost.
  [[nodiscard]] Next run_lockstep(const volatile int& stop);
  /// Behind a free-running plant its ticks are the timer; else, and while it is silent, the own clock is. Until the
  /// joint has stopped, or a plant in lockstep asks (`first_`).
  [[nodiscard]] Next run_on_clock(const volatile int& stop);
  [[nodiscard]] std::optional<plant_io::OwnTick> wait_for_instant(Time& scheduled) noexcept;
  /// One tick of the core; its frames are sent. False: the joint has been asked to stop and is safe.
  bool tick(Time now, const RawSensors& sensors, std::span<const can::ReceivedFrame> received, bool stopping) noexcept;
  void follow_cob_ids() noexcept;
  [[nodiscard]] plant_io::AnswerPayload answer() noexcept;
  void say(std::string_view sentence) const;

  ModuleConfig config_;
  ShellOptions options_;
  can::CanSocket can_;
  std::optional<plant_io::PlantLink> plant_;
  std::optional<plant_io::OwnTick> first_;
  std::unique_ptr<FileStore> store_;
  std::unique_ptr<Module> module_;
  ActuatorCommand actuator_;
  can::TransmitQueue tx_;
  plant_io::TickInbox inbox_;
  StaticVector<can::ReceivedFrame, plant_io::TickInbox::kCapacity + 1> received_;
  Time now_;
  Time stopping_since_;
  bool stopping_ = false;
  bool timer_of_plant_ = false;
  std::int64_t ticks_ = 0;
  std::int64_t times_off_ = 0;  ///< bus-off, as the module was told
  bool twin_seen_ = false;
  std::int64_t overruns_ = 0;        ///< ticks left out because the loop was late
  std::int64_t without_sample_ = 0;  ///< ticks by the wall clock for which no new sample had come
  std::uint64_t cob_ids_ = 0;        ///< fingerprint of those the kernel filters for
  Time blend_seen_;
  bool wholly_passive_ = false;
  Lateness lateness_;
};

}  // namespace mrr::fw
