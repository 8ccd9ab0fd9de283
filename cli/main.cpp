// Room: cli. The `mrr` command: thin, may use everything.
#include <fmt/format.h>

#include <CLI/CLI.hpp>

#include "cli/hammer.h"
#include "common/robot/errors.h"

int main(int argc, char** argv) {
  CLI::App app{"MRR: joints that survive the blow. Hammering with a modular reconfigurable robot."};
  app.name("mrr");
  app.require_subcommand(1);
  app.set_version_flag("--version", MRR_VERSION);
  app.footer("Exit status: 0 done within limits, 1 not done, 2 unusable input or plan, 3 defect.");
  app.failure_message([](const CLI::App*, const CLI::Error& error) {
    return fmt::format("mrr: {}; see mrr hammer --help\n", error.what());
  });
  int status = mrr::cli::kExitDone;
  mrr::cli::add_hammer_command(app, status);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? mrr::cli::kExitDone : mrr::cli::kExitUsage;
  } catch (const mrr::DescriptionError& error) {
    fmt::print(stderr, "mrr: {}\n", error.what());
    return mrr::cli::kExitUsage;
  } catch (const mrr::PlanError& error) {
    fmt::print(stderr, "mrr: {}\n", error.what());
    return mrr::cli::kExitUsage;
  } catch (const std::exception& error) {
    fmt::print(stderr, "mrr: internal error: {}\n", error.what());
    return mrr::cli::kExitInternal;
  }
  return status;
}
