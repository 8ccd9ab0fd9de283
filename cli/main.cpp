// Room: cli. The `mrr` command: thin, may use everything.
#include <fmt/format.h>

#include <algorithm>
#include <regex>
#include <stdexcept>

#include "can_protocol/socketcan/can_socket.h"
#include "cli/app.h"
#include "cli/exit_status.h"
#include "cli/hammer_bus.h"
#include "cli/robot_commands.h"
#include "common/robot/command_line.h"
#include "common/robot/errors.h"
#include "common/rpc/message.h"

namespace {

/// One sentence on stderr.
int complain(const std::exception& error, int status) {
  fmt::print(stderr, "mrr: {}\n", error.what());
  return status;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace mrr;
  int status = cli::kExitDone;
  const auto app = cli::make_app(status);
  app->failure_message([](const CLI::App* root, const CLI::Error& error) {
    std::string command = "mrr";
    for (const CLI::App* used : root->get_subcommands()) command += " " + used->get_name();
    // "Value 7 not in range 0.001000 to 1.000000": figures without the zeros.
    static const std::regex kZeros(R"((\.\d*?)0+(?=\D|$))");
    static const std::regex kPoint(R"((\d)\.(?=\D|$))");
    std::string what = error.what();
    if (what.find("not in range") != std::string::npos)
      what = std::regex_replace(std::regex_replace(what, kZeros, "$1"), kPoint, "$1");
    return fmt::format("mrr: {}; see {} --help\n", what, command);
  });
  const auto commands = cli::commands_of(*app);
  const auto is_first = [&](const CLI::App* command) { return command->get_name() == argv[1]; };
  if (argc > 1 && argv[1][0] != '-' && std::none_of(commands.begin(), commands.end(), is_first)) {
    fmt::print(stderr, "mrr: there is no command '{}'; see mrr --help\n", argv[1]);
    return cli::kExitUsage;
  }
  try {
    refuse_empty_values(*app);
    app->parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app->exit(error) == 0 ? cli::kExitDone : cli::kExitUsage;
  } catch (const DescriptionError& error) {
    return complain(error, cli::kExitUsage);
  } catch (const PlanError& error) {
    return complain(error, cli::kExitUsage);
  } catch (const cli::Interrupted& error) {
    return complain(error, cli::kExitInterrupted);
  } catch (const std::invalid_argument& error) {
    return complain(error, cli::kExitUsage);
  } catch (const rpc::Error& error) {
    return complain(error, cli::exit_status_of(error));
  } catch (const rpc::ConnectionError& error) {
    return complain(error, cli::kExitNotDone);
  } catch (const can::CanError& error) {
    return complain(error, cli::kExitNotDone);
  } catch (const rpc::Json::exception& error) {
    constexpr int kNotUtf8 = 316;  // of what is written, a name or path that was given
    if (error.id == kNotUtf8) return complain(error, cli::kExitUsage);
    // Nothing else here reads JSON: an answer lacks what docs/rpc.md says.
    fmt::print(stderr, "mrr: the answer is none of mrr_supervisor or mrr_plant ({}); see what runs at the socket\n",
               error.what());
    return cli::kExitNotDone;
  } catch (const std::exception& error) {
    fmt::print(stderr, "mrr: internal error: {}\n", error.what());
    return cli::kExitInternal;
  }
  return status;
}
