#include "can_protocol/node.h"
