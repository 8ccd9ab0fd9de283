#include "can_protocol/client.h"
