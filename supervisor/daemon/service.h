// Room: supervisor/daemon. Everything that may wait, allocate and talk: RPC methods, the hammering session with its
// planning, log, recording. One thread; meets the cycle only through its queues and its state.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "common/rpc/server.h"
#include "supervisor/daemon/cycle.h"
#include "supervisor/daemon/log_book.h"
#include "supervisor/ledger/ledger_file.h"
#include "supervisor/strike/session.h"

namespace mrr::sup {

/// What clients are told about how the daemon was started.
struct ServiceOptions {
  std::string can;    ///< interface of the robot's bus
  std::string plant;  ///< of the plant's, empty: not in lockstep
  std::uint32_t protocol_hash = 0;
  bool realtime_scheduling = false;
  bool memory_locked = false;
  LedgerFile* ledger = nullptr;  ///< of the gears; null: none is kept. Outlives the service
  /// Each switch is armed so much later than planned: contact then comes early, and the switch is pulled. For tests.
  Duration test_switch_late{};
};

/// Errors of docs/rpc.md.
enum class RpcError : int {
  not_ready = 1,
  busy = 2,
  outside_limits = 3,
  unknown_joint = 4,
  joint_unavailable = 5,
  nothing_to_do = 6,
  no_clock = 7,
  no_job = 8,
  shutting_down = 9,
  stale_configuration = 10,
};

class Service final : private RobotPort {
 public:
  /// How a request gets to the cycle and its answer back; nothing: the cycle stands still.
  using Call = std::function<std::optional<Answer>(const Request&)>;

  /// All must outlive this.
  Service(const RobotDescription& robot, const ServiceOptions& options, Cycle& cycle, Call call, LogBook& log);
  ~Service() override;
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  /// Puts the methods on a server, and sends it the events.
  void attach(rpc::Server& server);
  /// After a cycle, or every few milliseconds: takes what the cycle left, goes on with the job.
  void step();
  /// `running`: cycles are being made. In lockstep only while the plant ticks.
  void set_clock_running(bool running);

  /// Begins the end: jobs stop, joints are let go of. Called by `shutdown` and for signals.
  void shut_down(const std::string& why);
  [[nodiscard]] bool shutting_down() const noexcept { return shutting_down_; }
  /// All joints are let go of with their brakes on, as far as they are there.
  [[nodiscard]] bool is_down() const;

 private:
  struct Job;
  struct Fault {
    double time_s;
    int joint;
    std::uint16_t code;
    std::string text;
  };

  // RobotPort, for the session
  void enable(bool wanted) override;
  [[nodiscard]] Refusal execute(const StrikePlan& plan) override;
  [[nodiscard]] Activity activity() const override { return state_->activity; }
  [[nodiscard]] const SwingOutcome& outcome() const override { return state_->outcome; }
  [[nodiscard]] JointVector reference_position() const override { return state_->reference.q; }
  [[nodiscard]] NodeReport report(int joint) const override { return state_->nodes[static_cast<std::size_t>(joint)]; }

  // Methods
  [[nodiscard]] rpc::Json hello() const;
  [[nodiscard]] rpc::Json status();
  [[nodiscard]] rpc::Json ledger() const;
  [[nodiscard]] rpc::Json faults() const;
  [[nodiscard]] rpc::Json command(RequestKind kind, int joint = -1);
  [[nodiscard]] rpc::Json move(const rpc::Params& params);
  [[nodiscard]] rpc::Json hammer(const rpc::Params& params);
  [[nodiscard]] rpc::Json calibrate(const rpc::Params& params);
  [[nodiscard]] rpc::Json calibration() const;
  [[nodiscard]] rpc::Json job(const rpc::Params& params) const;
  [[nodiscard]] rpc::Json recording(const rpc::Params& params) const;
  [[nodiscard]] rpc::Json log_lines(const rpc::Params& params) const;

  [[nodiscard]] Answer ask(const Request& request);
  void refresh() { state_ = &cycle_.state(); }
  void require_running() const;
  void require_no_job() const;
  /// What begins something new must not begin it with a robot that its files no longer describe.
  void require_configuration() const;
  void require_holding() const;
  void require_clearance(int joint, double travel_rad) const;
  [[nodiscard]] std::string reason_of(CommandFailure failure) const;
  [[nodiscard]] int joint_of(const rpc::Params& params) const;
  [[nodiscard]] std::string why_not_ready() const;
  [[nodiscard]] std::string problem_of(int joint) const;
  [[nodiscard]] const std::string& name_of(int joint) const;
  [[nodiscard]] std::string words_of(int joint) const { return joint_words(robot_, joint); }
  [[nodiscard]] rpc::Json joint_json(int joint) const;

  void take_events();
  void take_rows();
  void watch_bus();
  [[nodiscard]] std::string why_down() const;
  void watch_clock();
  void step_job();
  void enter_in_ledger(const SwingReport& swing);
  void end_job(Verdict verdict, const std::string& reason);
  void notify(const char* kind, int joint, std::optional<std::int64_t> value, const std::string& text,
              rpc::Json more = rpc::Json::object());

  const RobotDescription& robot_;
  ServiceOptions options_;
  Cycle& cycle_;
  Call call_;
  LogBook& log_;
  rpc::Server* server_ = nullptr;
  const RobotState* state_;
  double load_computed_;

  bool clock_running_ = false;
  bool shutting_down_ = false;
  std::int64_t missed_told_ = 0;
  double missed_told_at_s_ = -1.0;
  std::int64_t not_sent_seen_ = 0;
  double full_until_s_ = -1.0;
  std::string bus_state_ = "up";
  std::string ledger_problem_;
  std::deque<Fault> faults_;
  bool source_changed_ = false;
  double source_checked_s_ = -1.0;
  std::uint32_t ended_command_ = 0;  ///< its reason is kept: joints change afterwards
  std::string ended_reason_;

  std::vector<std::unique_ptr<Job>> jobs_;  ///< all that were run, for their results
  std::vector<RecordRow> rows_;
  std::int64_t rows_lost_before_ = 0;
  std::int64_t rows_too_many_ = 0;
};

}  // namespace mrr::sup
