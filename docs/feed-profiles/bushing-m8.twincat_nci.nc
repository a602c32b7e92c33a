(feedwright-export 1)
(dialect twincat_nci)
(profile bushing-M8:long)
(version 3)
(hash 53c9f42fe3459857800a95c338cee5731f8680c63017a1d738af42939283365e)
(! warning: try it without a workpiece and with a low override first.)
(! the control's limits and the emergency stop stay the safety layer.)
(! do not edit: a changed file no longer has its hash. change the profile instead.)
(! units: mm, mm/min, percent of the machine's ratings.)
(! depth d below first contact is z = -d, z0 is first contact. absolute, feed per minute.)
(! the caller has the tool above the hole at or above the clearance, its length compensated,)
(! the work offset active and the spindle at its speed: none of it is done here.)
(! program. the feed is in mm/min by the channel's setting.)
(clearance_mm 1.000)
(operation bushing-m8)
(tool_type flow-drill=207.3=20long)
(program O1234=20=28left=29)
(work_material S235JRH,=202=20mm)
(spindle_speed_rpm 2800.000)
(feed_min_mm_min 50.000)
(feed_max_mm_min 1000.000)
(acceleration_mm_s2 300.000)
(override_min_percent 5.000)
(override_max_percent 200.000)
(spindle_load_set_percent 40.000)
(feed_drive_load_set_percent 30.000)
(wear_from_level -)
(wear_to_level 1.070)
(section heating 3.000)
(section forming 13.000)
(section idle_travel 18.000)
(section flange 20.500)
(end)
G90 G71
FCONST
G0 Z1.000
G1 Z0.000 F105.000
FLIN
G1 Z-3.000 F155.000
G1 Z-7.000 F535.000
G1 Z-12.000 F205.000
G1 Z-14.500 F545.000
G1 Z-17.500 F545.000
G1 Z-20.500 F345.000
FCONST
G0 Z1.000
M30
