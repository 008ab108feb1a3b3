#include "interface.h"

@{guards}
@{definitions}