// A module that speaks another protocol, or was configured otherwise, is not used: said by hand-made answers.
#include <gtest/gtest.h>

#include "can_protocol/codec.h"
#include "can_protocol/messages.h"
#include "can_protocol/object_dictionary.h"
#include "supervisor/master/node_proxy.h"

namespace mrr::sup {
namespace {

constexpr std::uint8_t kNode = 3;
constexpr std::uint32_t kConfiguration = 0x12345678;

/// Boots, and answers each question for an object of 4 bytes.
NodeProxy answered(std::uint32_t protocol, std::uint32_t configuration, int& asked_further) {
  NodeSettings settings;
  settings.node_id = kNode;
  settings.configuration_hash = kConfiguration;
  NodeProxy node(settings);
  asked_further = 0;
  Time now;
  node.receive({can::heartbeat_frame(kNode, can::NmtState::initialising), now});
  for (int i = 0; i < 500; ++i, now += milliseconds(1)) {
    can::TransmitQueue tx;
    node.step(now, tx);
    for (const can::Frame& f : tx) {
      if (f.id != can::kSdoRequestCobId + kNode) continue;
      const auto index = can::get<std::uint16_t>(f.data.data() + 1);
      if (index != 0x2000 && index != 0x2001) {
        ++asked_further;
        continue;
      }
      can::Frame answer;
      answer.id = can::kSdoReplyCobId + kNode;
      answer.length = 8;
      answer.data[0] = 0x43;
      can::put<std::uint16_t>(answer.data.data() + 1, index);
      can::put<std::uint32_t>(answer.data.data() + 4, index == 0x2000 ? protocol : configuration);
      node.receive({answer, now});
    }
    if (i % 50 == 0) node.receive({can::heartbeat_frame(kNode, can::NmtState::pre_operational), now});
  }
  return node;
}

TEST(Identity, AnotherProtocolIsRefused) {
  int asked_further = 0;
  const NodeProxy node = answered(can::kProtocolHash ^ 1U, kConfiguration, asked_further);
  EXPECT_EQ(node.stage(), NodeStage::refused);
  EXPECT_EQ(node.problem(), NodeProblem::wrong_protocol);
  EXPECT_EQ(asked_further, 0);
}

TEST(Identity, AnotherConfigurationIsRefused) {
  int asked_further = 0;
  const NodeProxy node = answered(can::kProtocolHash, kConfiguration ^ 1U, asked_further);
  EXPECT_EQ(node.stage(), NodeStage::refused);
  EXPECT_EQ(node.problem(), NodeProblem::wrong_configuration);
  EXPECT_EQ(asked_further, 0);
}

TEST(Identity, TheRightOneIsConfigured) {
  int asked_further = 0;
  const NodeProxy node = answered(can::kProtocolHash, kConfiguration, asked_further);
  EXPECT_NE(node.problem(), NodeProblem::wrong_protocol);
  EXPECT_NE(node.problem(), NodeProblem::wrong_configuration);
  EXPECT_GT(asked_further, 0);
}

}  // namespace
}  // namespace mrr::sup
