/* From messages to observations of @{name}, and from its decisions to velocities, as in evolution. */
#ifndef INTERFACE_H
#define INTERFACE_H

@{includes}
@{declarations}
#endif
