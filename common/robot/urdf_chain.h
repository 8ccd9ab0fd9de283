// Room: common/robot. A URDF as a serial chain of revolute joints, fixed joints merged into what carries them. Host
// only. Used by load_robot(); may touch urdfdom and TinyXML (hidden in the .cpp).
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/robot/errors.h"
#include "common/robot/robot.h"

namespace mrr {

/// outer <- inner, written as one transform: compose(a <- b, b <- c) is a <- c.
[[nodiscard]] FrameOffset compose(const FrameOffset& outer, const FrameOffset& inner);

/// A body and where its frame sits in the frame of the link that carries it.
struct PlacedBody {
  FrameOffset pose;
  LinkDescription body;
};

/// One rigid body out of several: masses added, centre of mass their mean, inertia by the parallel-axis theorem about
/// the common centre of mass, axes of the carrying frame. No bodies: mass 0.
[[nodiscard]] LinkDescription merge_bodies(const std::string& name, const std::vector<PlacedBody>& bodies);

/// What makes a body impossible (mass not above 0, inertia not positive definite, triangle inequality of the principal
/// moments broken by more than 1e-9 of their sum), in words after which only a full stop is missing; nothing if sound.
[[nodiscard]] std::optional<std::string> impossible_body(const LinkDescription& body);

/// A link of the URDF, placed in the moving link (or base) it is rigidly attached to.
struct PlacedLink {
  int carrier = -1;  ///< index of the joint that moves it; -1: the base
  FrameOffset pose;  ///< carrier link frame <- this link's frame
};

struct UrdfChain {
  std::string name;
  /// From base to tip; name, offset, axis, link and the limits that a URDF has (position, velocity, effort) are filled.
  std::vector<JointDescription> joints;
  std::map<std::string, PlacedLink> links;
};

/// Reads `file`. Throws DescriptionError naming file, line and element for everything that is not such a chain.
[[nodiscard]] UrdfChain read_urdf_chain(const std::filesystem::path& file);

}  // namespace mrr
