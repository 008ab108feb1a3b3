#include "interface.h"

@{definitions}