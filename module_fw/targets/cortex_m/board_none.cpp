// Room: module_fw/targets/cortex_m. A bare core without peripherals: every sensor is silent, the bus is not connected.
// A module on it stays without torque, brake engaged. It exists so that the image links and its size and stack can be
// measured. Its parameter flash is RAM that behaves like flash: a stored parameter lasts until the power goes.
#include "module_fw/targets/cortex_m/board.h"

namespace mrr::fw::board {

namespace {

constexpr std::uint32_t kClockHz = 170'000'000;
volatile std::int16_t duty;  // where a power stage's register would be
volatile bool stage_enabled;
volatile bool brake_release;

class EmulatedFlash final : public Flash {
 public:
  [[nodiscard]] std::span<const std::uint8_t> bytes() const noexcept override { return memory_; }
  [[nodiscard]] std::size_t page_bytes() const noexcept override { return kPageBytes; }
  [[nodiscard]] State state() noexcept override { return State::idle; }
  void erase(std::size_t page) noexcept override {
    std::fill_n(memory_.begin() + static_cast<std::ptrdiff_t>(page * kPageBytes), kPageBytes, std::uint8_t{0xFF});
  }
  void program(std::size_t offset, const Word& word) noexcept override {
    for (std::size_t i = 0; i < word.size(); ++i)
      memory_[offset + i] = static_cast<std::uint8_t>(memory_[offset + i] & word[i]);
  }

 private:
  static constexpr std::size_t kPageBytes = 2048;
  std::array<std::uint8_t, 2 * FlashStore::slot_pages(kPageBytes) * kPageBytes> memory_{};
};
EmulatedFlash flash;

}  // namespace

Flash& parameter_flash() noexcept { return flash; }

std::uint32_t start() noexcept { return kClockHz; }

RawSensors read_sensors() noexcept { return {}; }

void actuate(const ActuatorCommand& command) noexcept {
  duty = command.current_duty;
  stage_enabled = command.power_stage_enabled;
  brake_release = command.brake_release;
}

bool receive(can::ReceivedFrame&) noexcept { return false; }

bool transmit(const can::Frame&) noexcept { return false; }

}  // namespace mrr::fw::board
