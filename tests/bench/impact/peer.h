// Plain C between the benchmark and a peer that is opened at run time.
#pragma once

extern "C" {

struct PeerJoint {
  double rotation[9];  // parent <- joint, column by column
  double offset[3];    // m, parent frame
  double axis[3];      // joint frame
  double com[3];       // m, link frame
  double inertia[9];   // kg m^2 about com, link axes
  double mass;
  double rotor_inertia;  // gamma^2 I_r, kg m^2
};

// peer_create(joints, n, face centre in the last link's frame)
using PeerCreate = void* (*)(const PeerJoint*, int, const double*);
// peer_predict(peer, q, q', normal, e, axis impulses out, wrenches out): the impulse on the face; rigid board, all
// joints free. Wrenches (force; torque) in each link's own frame.
using PeerPredict = double (*)(void*, const double*, const double*, const double*, double, double*, double*);
}
