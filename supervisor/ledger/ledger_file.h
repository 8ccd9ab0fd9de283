// Room: supervisor/ledger. The ledger in a file that survives restarts and power cuts: written aside, flushed, put in
// place; versioned, checksummed, its owner's alone. Host only; touches the one file, FILE.lock and FILE.new.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "supervisor/ledger/ledger.h"

namespace mrr::sup {

/// Format that is written, and the newest that is read.
inline constexpr int kLedgerVersion = 1;

/// The file's whole text.
[[nodiscard]] std::string ledger_text(const RobotDescription& robot, const Ledger& ledger);
/// Throws DescriptionError if `text` is not exactly what ledger_text() gives for this robot: not a ledger, torn,
/// damaged, of another robot or another gear, of a newer program. `place` names the file.
[[nodiscard]] Ledger read_ledger(const RobotDescription& robot, std::string_view text, const std::string& place);

/// An open ledger: nobody else writes it meanwhile.
class LedgerFile {
 public:
  /// Reads `file`, or begins a new ledger where there is no file; `today` as "2026-01-31". What is there and cannot be
  /// read is refused and left as it is, never begun anew. Throws DescriptionError.
  LedgerFile(const RobotDescription& robot, std::filesystem::path file, const std::string& today);
  ~LedgerFile();
  LedgerFile(const LedgerFile&) = delete;
  LedgerFile& operator=(const LedgerFile&) = delete;

  /// Enters a swing and writes the file; when it returns, a power cut takes nothing of it. Throws DescriptionError if
  /// writing failed: the file is then as it was before, and the ledger in memory goes on.
  void enter(const SwingReport& swing);

  [[nodiscard]] const Ledger& ledger() const noexcept { return ledger_; }
  [[nodiscard]] bool begun() const noexcept { return begun_; }  ///< there was no file
  [[nodiscard]] const std::filesystem::path& file() const noexcept { return file_; }

 private:
  void write() const;

  const RobotDescription& robot_;
  std::filesystem::path file_;
  Ledger ledger_;
  int lock_ = -1;
  bool begun_ = false;
};

/// Where a robot's ledger is kept unless told otherwise: ledger-NAME in $MRR_STATE_DIR, else systemd's
/// $STATE_DIRECTORY, else $XDG_STATE_HOME/mrr, else ~/.local/state/mrr. The folder is made, for its owner alone. Throws
/// DescriptionError.
[[nodiscard]] std::filesystem::path default_ledger(const RobotDescription& robot);

/// Today in UTC, "2026-01-31".
[[nodiscard]] std::string today_utc();

}  // namespace mrr::sup
